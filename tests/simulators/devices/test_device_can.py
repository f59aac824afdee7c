"""The emulated CAN adapter and CiA 404 node, byte for byte."""

import asyncio
import os
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from simulators.devices import Cia404Node, SlcanAdapter
from simulators.devices.source import SensorFault

pytestmark = pytest.mark.simulated_time


@pytest.fixture
def node() -> Cia404Node:
    return Cia404Node(5, lambda: [20.04, -3.3], inputs=2)


@pytest.mark.parametrize(
    ("asked", "answered"),
    [
        pytest.param("40 00 10 00", "43 00 10 00 94 01 02 00", id="device type: profile 404"),
        pytest.param("40 30 71 01", "4B 30 71 01 C8 00 00 00", id="int16 process value in tenths"),
        pytest.param("40 30 91 02", "43 30 91 02 DF FF FF FF", id="int32 process value, negative"),
        pytest.param("40 50 61 01", "4F 50 61 01 00 00 00 00", id="status"),
        pytest.param("40 32 61 01", "4F 32 61 01 01 00 00 00", id="one decimal digit"),
        pytest.param("40 30 71 03", "80 30 71 03 11 00 09 06", id="no such sub-index"),
        pytest.param("40 31 71 01", "80 31 71 01 00 00 02 06", id="no such object"),
        pytest.param("2B 30 71 01", "80 30 71 01 02 00 01 06", id="read-only"),
    ],
)
def test_sdo(node: Cia404Node, asked: str, answered: str) -> None:
    request = bytes.fromhex(asked).ljust(8, b"\0")
    assert node.on_frame(0x605, request) == ((0x585, bytes.fromhex(answered)),)


@pytest.mark.parametrize(
    ("vendor", "fault", "status"),
    [
        ("jumo", SensorFault.OPEN, 1),
        ("jumo", SensorFault.OVER, 2),
        ("jumo", SensorFault.UNDER, 4),
        ("axiomatic", SensorFault.OPEN, 3),
        ("axiomatic", SensorFault.UNDER, 0x10),
        ("axiomatic", SensorFault.OVER, 0x20),
        ("esd", SensorFault.OPEN, 1),
    ],
)
def test_status_follows_the_vendors_table(vendor: str, fault: SensorFault, status: int) -> None:
    node = Cia404Node(5, lambda: [20.0], inputs=1, vendor=vendor)
    node.faults.set(0, fault)
    ((_, data),) = node.on_frame(0x605, bytes.fromhex("40 50 61 01 00 00 00 00"))
    assert data[4] == status


def test_reset_is_followed_by_boot_up(node: Cia404Node) -> None:
    assert node.on_frame(0, bytes((129, 5))) == ((0x705, b"\0"),)
    assert node.on_frame(0, bytes((129, 6))) == ()


def test_stopped_node_answers_no_sdo(node: Cia404Node) -> None:
    request = bytes.fromhex("40 00 10 00 00 00 00 00")
    assert node.on_frame(0, bytes((2, 5))) == ()
    assert node.on_frame(0x605, request) == ()
    node.on_frame(0, bytes((1, 5)))
    assert node.on_frame(0x605, request) != ()


@pytest.fixture
async def adapter(node: Cia404Node) -> AsyncIterator[int]:
    """A client's descriptor of the adapter's serial port."""
    adapter = SlcanAdapter([node])
    descriptor = os.open(Path(await adapter.start()), os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    yield descriptor
    os.close(descriptor)
    await adapter.stop()


async def _exchange(descriptor: int, line: bytes) -> bytes:
    os.write(descriptor, line)
    for _ in range(100):
        await asyncio.sleep(0.001)
        try:
            return os.read(descriptor, 100)
        except BlockingIOError:
            continue
    return b""


async def test_adapter_passes_frames_only_while_open(adapter: int) -> None:
    request = b"t60584000100000000000\r"
    assert await _exchange(adapter, request) == b"\a"
    assert await _exchange(adapter, b"S4\r") == b"\r"
    assert await _exchange(adapter, b"O\r") == b"\r"
    assert await _exchange(adapter, request) == b"\rt58584300100094010200\r"
    assert await _exchange(adapter, b"C\r") == b"\r"
    assert await _exchange(adapter, request) == b"\a"


@pytest.mark.parametrize(
    "line", [b"t6058400010\r", b"t60X0\r", b"t6059000000000000000000\r", b"q\r", b"\xff\r", b"S4\r"]
)
async def test_adapter_refuses_nonsense(adapter: int, line: bytes) -> None:
    await _exchange(adapter, b"O\r")
    assert await _exchange(adapter, line) == b"\a"
    assert await _exchange(adapter, b"\r") == b"\r"
