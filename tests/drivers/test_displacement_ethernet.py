"""Micro-Epsilon's Ethernet stream: blocks are found whole, newest first, among whatever else comes."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.base import SystemClock, WrongDevice
from drivers.build import make_bus, make_device
from drivers.me_ethernet import find_block
from simulators.devices.me_controller import MeController, block

# "MEAS", order 1, serial 2, channels 0 and 2, status 0, two frames of 8 bytes, counter 7, values 1 2 and 3 -1
HEXADECIMAL = (
    "4D454153 01000000 02000000 1100000000000000 00000000 0200 0800 07000000 01000000 02000000 03000000 FFFFFFFF"
)


def test_newest_frame_and_the_channels_fitted() -> None:
    found = find_block(bytes.fromhex(HEXADECIMAL))
    assert found is not None
    assert (found.order, found.serial) == (1, 2)
    assert found.values == {0: 3, 2: -1}


def test_newest_of_several_blocks_is_taken_and_a_part_is_not() -> None:
    first, second, third = (block([[counter]], counter) for counter in (1, 2, 3))
    found = find_block(first[5:] + first + second + third[:-1])
    assert found is not None
    assert found.values == {0: 2}


def test_name_of_the_block_among_its_values_is_no_block() -> None:
    word = int.from_bytes(b"MEAS", "little")
    found = find_block(block([[word] * 8, [5] * 8], 1)[32:] + block([[word] * 8], 2))
    assert found is not None
    assert set(found.values.values()) == {word}


@pytest.mark.parametrize("lost", range(1, 8))
def test_block_that_lost_bytes_is_not_filled_up_with_those_of_the_next(lost: int) -> None:
    cut, whole = block([[1000, 2000]], 1)[:-lost], block([[7, 8]], 2)
    found = find_block(cut + whole)
    assert found is not None
    assert found.values == {0: 7, 1: 8}
    assert find_block(cut + whole[:-1]) is None


def test_bytes_too_many_make_no_block() -> None:
    assert find_block(block([[1000, 2000]], 1) + b"\0\0") is None


@given(st.binary(max_size=200), st.booleans())
def test_any_bytes_are_survived(heard: bytes, with_name: bool) -> None:
    heard = b"MEAS" + heard if with_name else heard
    found = find_block(heard)
    assert found is None or len(heard) >= 32 + 4 * len(found.values)


async def test_channel_that_is_not_fitted_is_named() -> None:
    controller = MeController(lambda: [100.0], range_um=500.0)
    bus = make_bus("growth", "me_ethernet", {"host": "127.0.0.1", "port": await controller.start()})
    options = {"range_um": 500.0}
    driver = make_device("eddy", bus, "me_ethernet", 1, {"nose": 3}, options, SystemClock())
    try:
        await bus.connect()
        with pytest.raises(WrongDevice, match=r"has no channel 3 \(channels fitted: 0\)"):
            await driver.connect()
    finally:
        await bus.close()
        await controller.stop()
