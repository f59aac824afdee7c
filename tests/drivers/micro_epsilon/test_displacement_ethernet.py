"""Micro-Epsilon's Ethernet stream: complete blocks are found, newest first, among any other bytes."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from itertools import accumulate, pairwise
from math import nan

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.base import Driver, Quality, SystemClock, WrongDevice
from drivers.build import make_device
from drivers.micro_epsilon.ethernet import MeBlock, find_block
from simulators.devices.me_controller import MeController, block
from tests.benches.buses import make_bus
from tests.benches.waits import until

pytestmark = pytest.mark.simulated_time

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
    heard = block([[word] * 8, [5] * 8], 1)[32:] + block([[word] * 8], 2)
    assert find_block(heard) is None, "what ends like a header may be one"
    found = find_block(heard + b"MEAS")
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


MEAS = int.from_bytes(b"MEAS", "little")
RAW = st.one_of(st.integers(0, 0xFFFFFF), st.sampled_from([0, 1, -1, 8, 0x11, MEAS, 2303021, 1001]))
"""Within the range, or what a header holds."""


@st.composite
def streams(draw: st.DrawFn, blocks: int = 4) -> list[list[list[int]]]:
    """Frames of blocks, as one controller sends them: equally many channels in all."""
    channels = draw(st.integers(1, 5))
    frame = st.lists(RAW, min_size=channels, max_size=channels)
    return draw(st.lists(st.lists(frame, min_size=1, max_size=3), min_size=1, max_size=blocks))


def stands_in(heard: bytes, found: MeBlock) -> bool:
    """Whether the bytes contain such a block whole, read as the manual says and not as the driver does."""
    for start in range(len(heard) - 31):
        if heard[start : start + 4] != b"MEAS":
            continue
        fitted = [c for c in range(32) if heard[start + 12 + c // 4] >> 2 * (c % 4) & 3]
        frames, size = (int.from_bytes(heard[at : at + 2], "little") for at in (start + 24, start + 26))
        end = start + 32 + frames * size
        newest = heard[end - size : end]
        values = [int.from_bytes(newest[i : i + 4], "little", signed=True) for i in range(0, size, 4)]
        order, serial = (int.from_bytes(heard[at : at + 4], "little") for at in (start + 4, start + 8))
        whole = size == 4 * len(fitted) and frames > 0 and end <= len(heard)
        if whole and (order, serial, dict(zip(fitted, values, strict=True))) == (
            found.order, found.serial, found.values,
        ):  # fmt: skip
            return True
    return False


@given(st.lists(st.one_of(st.binary(max_size=60), st.sampled_from([b"MEAS", bytes.fromhex(HEXADECIMAL)])), max_size=8))
def test_what_is_found_in_any_bytes_stands_there_whole(parts: list[bytes]) -> None:
    heard = b"".join(parts)
    found = find_block(heard)
    assert found is None or stands_in(heard, found)


@given(streams(), st.data())
def test_newest_whole_block_of_a_stream_is_found_wherever_it_begins_and_ends(
    frames: list[list[list[int]]], data: st.DataObject
) -> None:
    blocks = [block(each, number) for number, each in enumerate(frames)]
    first = blocks[0][data.draw(st.integers(1, len(blocks[0]))) :]
    part = blocks[-1][: data.draw(st.integers(4, len(blocks[-1]) - 1))]
    found = find_block(first + b"".join(blocks) + part)
    assert found is not None
    assert list(found.values.values()) == frames[-1][-1]


@given(streams(), st.data())
def test_stream_that_lost_bytes_gives_blocks_that_were_sent_or_none(
    frames: list[list[list[int]]], data: st.DataObject
) -> None:
    """Within one block; if the name of the next is lost, too, nothing distinguishes the two from one."""
    frames = [[[value & 0xFFFFFF for value in frame] for frame in each] for each in frames]  # what is measured
    blocks = [block(each, number) for number, each in enumerate(frames)]
    hurt = data.draw(st.integers(0, len(blocks) - 1))
    start = data.draw(st.integers(0, len(blocks[hurt]) - 1))
    lost = data.draw(st.integers(1, len(blocks[hurt]) - start))
    ends = list(accumulate(map(len, blocks)))  # where a block would be filled up
    blocks[hurt] = blocks[hurt][:start] + blocks[hurt][start + lost :]
    rest = b"".join(blocks)
    found = find_block(rest[: data.draw(st.sampled_from(ends) | st.integers(0, len(rest)))])
    assert found is None or list(found.values.values()) in [each[-1] for each in frames]


async def _read_through(sent: bytes, cuts: list[int], channels: int) -> list[float]:
    """What the driver reads when these bytes come in these pieces, from the moment it asks."""
    clients: list[asyncio.StreamWriter] = []
    server = await asyncio.start_server(lambda _, writer: clients.append(writer), "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    bus = make_bus("growth", "me_ethernet", {"host": "127.0.0.1", "port": port, "timeout_s": 5.0})
    names = {f"c{i}": i for i in range(channels)}
    driver = make_device("eddy", bus, "me_ethernet", 1, names, {"range_um": 500.0}, SystemClock())
    try:
        await bus.connect()
        reading = asyncio.create_task(driver.read())
        await asyncio.sleep(0)  # now it waits for what comes
        await until(lambda: clients, pause_s=0.0)
        for begin, end in pairwise([0, *sorted(cuts), len(sent)]):
            clients[0].write(sent[begin:end])
            await clients[0].drain()
            await asyncio.sleep(0)
        return [reading.value for reading in await reading]
    finally:
        await bus.close()
        for client in clients:
            client.close()
        server.close()
        await server.wait_closed()


def um(raw: int) -> float:
    """The distance of a count at a range of 500 µm; both ends of the 24 bits are none."""
    return raw / 0xFFFFFF * 500.0 if 0 < raw < 0xFFFFFF else nan


def test_driver_reads_one_of_the_blocks_that_came_whole_however_they_came() -> None:
    with asyncio.Runner() as runner:

        @settings(max_examples=60)
        @given(streams(), st.data())
        def any_stream(frames: list[list[list[int]]], data: st.DataObject) -> None:
            frames = [[[value & 0xFFFFFF for value in frame] for frame in each] for each in frames]
            blocks = [block(each, number) for number, each in enumerate(frames)]
            first = blocks[0][data.draw(st.integers(1, len(blocks[0]))) :]
            sent = first + b"".join(blocks)
            cuts = data.draw(st.lists(st.integers(0, len(sent)), max_size=6))
            values = runner.run(_read_through(sent, cuts, len(frames[0][0])))
            assert values in [pytest.approx([um(raw) for raw in each[-1]], nan_ok=True) for each in frames]

        any_stream()


async def test_channel_that_is_not_fitted_is_named() -> None:
    controller = MeController(lambda: [100.0], range_um=500.0)
    bus = make_bus("growth", "me_ethernet", {"host": "127.0.0.1", "port": await controller.start()})
    options = {"range_um": 500.0}
    driver = make_device("eddy", bus, "me_ethernet", 1, {"nose": 3}, options, SystemClock())
    try:
        await bus.connect()
        with pytest.raises(WrongDevice, match=r"channel 3 .*0"):
            await driver.connect()
    finally:
        await bus.close()
        await controller.stop()


async def test_channels_with_different_ranges_are_several_devices_on_one_bus() -> None:
    controller = MeController(lambda: [100.0, 200.0], range_um=500.0)
    bus = make_bus("growth", "me_ethernet", {"host": "127.0.0.1", "port": await controller.start()})
    ranges = {"nose": 500.0, "tail": 2000.0}
    drivers = [
        make_device(name, bus, "me_ethernet", 1, {name: number}, {"range_um": range_um}, SystemClock())
        for number, (name, range_um) in enumerate(ranges.items())
    ]
    try:
        await bus.connect()
        values = [(await driver.read())[0].value for driver in drivers]
    finally:
        await bus.close()
        await controller.stop()
    assert values == pytest.approx([100.0, 800.0], abs=0.01)


@asynccontextmanager
async def streaming(distances_um: list[float]) -> AsyncIterator[tuple[MeController, Driver]]:
    """A controller with one channel for each distance, range 500 µm, and a driver that reads them all."""
    controller = MeController(lambda: distances_um, range_um=500.0)
    bus = make_bus("growth", "me_ethernet", {"host": "127.0.0.1", "port": await controller.start()})
    names = {f"c{i}": i for i in range(len(distances_um))}
    driver = make_device("eddy", bus, "me_ethernet", 1, names, {"range_um": 500.0}, SystemClock())
    try:
        await bus.connect()
        await driver.connect()
        yield controller, driver
    finally:
        await bus.close()
        await controller.stop()


async def test_both_ends_of_the_24_bits_are_no_distance() -> None:
    """What a probe reads that is unplugged or sees no target."""
    distances = [0.0, 250.0, 500.0]
    async with streaming(distances) as (_, driver):
        low, middle, high = await driver.read()
        assert (low.quality, middle.quality, high.quality) == (
            Quality.OUT_OF_RANGE, Quality.GOOD, Quality.OUT_OF_RANGE,
        )  # fmt: skip
        assert middle.value == pytest.approx(250.0, abs=0.01)
        distances[:] = [500.0 / 0xFFFFFF, 250.0, 500.0 - 500.0 / 0xFFFFFF]
        assert [reading.quality for reading in await driver.read()] == [Quality.GOOD] * 3


async def test_controller_whose_counter_stands_still_gives_no_values() -> None:
    async with streaming([250.0]) as (controller, driver):
        assert (await driver.read())[0].quality is Quality.GOOD
        controller.frozen = True
        await driver.read()  # the block that it repeats may be a new one
        for _ in range(3):
            (reading,) = await driver.read()
            assert reading.quality is Quality.STALE
        controller.frozen = False
        assert (await driver.read())[0].quality is Quality.GOOD


async def test_another_controller_is_refused_whatever_the_connection() -> None:
    async with streaming([250.0]) as (controller, driver):
        await driver.read()
        controller.serial = 1002
        for ask in (driver.read, driver.connect):
            with pytest.raises(WrongDevice, match=r"1002.*1001"):
                await ask()
        controller.serial = 1001
        assert (await driver.read())[0].quality is Quality.GOOD
