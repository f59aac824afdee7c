"""Another master on the line: its frames, encoded by pymodbus, are distinguished from everything else that may be
heard."""

import asyncio
from collections.abc import Callable, Sequence

import pytest
from pymodbus.framer.rtu import FramerRTU
from pymodbus.pdu import DecodePDU, ExceptionResponse, ModbusPDU
from pymodbus.pdu.bit_message import ReadCoilsRequest, ReadCoilsResponse
from pymodbus.pdu.register_message import (
    ReadHoldingRegistersRequest,
    ReadHoldingRegistersResponse,
    WriteSingleRegisterRequest,
)

from drivers.base import DriverError
from drivers.modbus.frames import rtu_request
from drivers.modbus.numbers import Block
from drivers.modbus.rtu import ModbusRtuBus
from drivers.modbus.strangers import Strangers
from tests.benches.rtu_talk import TWO, RtuPeer, honest, line, registers

pytestmark = pytest.mark.simulated_time

OURS = 3
_FRAMER = FramerRTU(DecodePDU(False))


def framed(pdu: ModbusPDU, unit: int) -> bytes:
    pdu.dev_id = unit
    return _FRAMER.buildFrame(pdu)


ASKS = framed(ReadHoldingRegistersRequest(address=10, count=2), 9)
ANSWER = framed(ReadHoldingRegistersResponse(registers=[7, 8]), 9)


async def told(between: Sequence[bytes], reply: Callable[[bytes], bytes] = honest, periods: int = 4) -> str:
    """What the bus reports after some periods, with these bytes heard before each."""
    async with line() as (bus, peer):
        peer.reply = reply
        await _periods(bus, peer, between, periods)
        return bus.other_master()


async def _periods(bus: ModbusRtuBus, peer: RtuPeer, between: Sequence[bytes], periods: int) -> None:
    for _ in range(periods):
        for heard in between:
            peer.port.write(heard)
        await asyncio.sleep(1.0)
        try:
            await bus.read("rtd1", OURS, TWO)
        except DriverError:
            await asyncio.sleep(0.5)


@pytest.mark.parametrize(
    "between",
    [
        [ASKS, ANSWER],
        [ANSWER],
        [b"\xff\x00" + ASKS + ANSWER[:3]],
        [framed(WriteSingleRegisterRequest(address=1, registers=[5]), 9)],
        [framed(ReadCoilsRequest(address=0, count=4), OURS), framed(ReadCoilsResponse(bits=[True] * 4), OURS)],
        [framed(ExceptionResponse(3, 2), 9)],
        [framed(ReadHoldingRegistersRequest(address=0, count=2), OURS)],  # our own unit, by another function
    ],
)
async def test_another_masters_frames_show(between: list[bytes]) -> None:
    text = await told(between)
    unit, function = (OURS, 1) if between[0][:2] == b"\x03\x01" else (OURS, 3) if between[0][0] == OURS else (9, 0)
    assert f"unit {unit}, function " in text
    assert f"function {function}" in text or not function
    assert "frames in the last minute are not ours" in text


NOISE = bytes(range(250))


@pytest.mark.parametrize(
    ("between", "reply"),
    [
        ([], honest),
        ([NOISE, b"\x00" * 30], honest),
        ([registers(OURS, 1, 2)], honest),  # a second answer to our question, long after
        ([], lambda request: honest(request) * 2),  # two units with one id
        ([], lambda request: request + honest(request)),  # local echo
        ([], lambda request: honest(request)[:-1] + b"\x00"),  # disturbed
        ([], lambda _: b""),
        ([], lambda _: registers(OURS, *range(9))),  # more than was asked for
        ([ASKS[:-1] + b"\x00", ANSWER[:-2]], honest),  # disturbed, or cut
    ],
)
async def test_nothing_else_does(between: list[bytes], reply: Callable[[bytes], bytes]) -> None:
    assert await told(between, reply, periods=8) == ""


async def test_one_frame_is_not_a_master_and_what_is_over_is_forgotten() -> None:
    async with line() as (bus, peer):
        peer.reply = honest
        await _periods(bus, peer, [ANSWER], 2)
        assert bus.other_master() == ""
        await _periods(bus, peer, [ANSWER], 1)
        assert bus.other_master() != ""
        await asyncio.sleep(61.0)
        assert bus.other_master() == ""


async def test_our_values_stay_right() -> None:
    async with line() as (bus, peer):
        peer.reply = lambda request: ANSWER + honest(request)
        assert [await bus.read("rtd1", OURS, Block(4, 0, 2)) for _ in range(4)] == [(100, 101)] * 4
        assert bus.other_master() != ""


def test_requests_that_come_back_are_our_own() -> None:
    """Local echo that arrives late, or through a repeater."""
    strangers, ours, other = Strangers(), Block(4, 0, 6), Block(4, 1, 6)
    strangers.asked(1, ours)
    for at_s in range(5):
        strangers.note(rtu_request(1, ours), float(at_s))
    assert strangers.evidence(5.0) == ""
    for at_s in range(5):
        strangers.note(rtu_request(1, other), float(at_s))
    assert "5 frames in the last minute are not ours" in strangers.evidence(5.0)


class SharedUnit:
    """A unit that two masters ask; it answers in order, a moment later. Register n holds n, and each hears all."""

    def __init__(self, peer: RtuPeer) -> None:
        self._peer = peer
        self._free_s = 0.0
        peer.reply = self._reply

    def _reply(self, request: bytes) -> bytes:
        self.asked(request)
        return b""

    def asked(self, request: bytes) -> None:
        loop = asyncio.get_running_loop()
        self._free_s = max(loop.time(), self._free_s) + 0.02
        first = int.from_bytes(request[2:4], "big")
        loop.call_at(self._free_s, self._peer.port.write, honest(request, first))

    def asked_by_the_other(self, request: bytes) -> None:
        self._peer.port.write(request)
        self.asked(request)


@pytest.mark.parametrize("every_s", [0.07, 0.19, 0.61])
async def test_registers_of_another_masters_request_are_not_ours(every_s: float) -> None:
    """It asks the same unit for as many registers, at any moment."""
    other = rtu_request(OURS, Block(4, 500, 2))
    async with line(0.3) as (bus, peer):
        unit = SharedUnit(peer)

        async def second_master() -> None:
            while True:
                await asyncio.sleep(every_s)
                unit.asked_by_the_other(other)

        task = asyncio.create_task(second_master())
        read = 0
        try:
            for _ in range(60):
                for again in (False, True, True):
                    try:
                        words = await bus.read("rtd1", OURS, TWO, again=again)
                    except DriverError:
                        continue
                    assert words == (0, 1)
                    read += 1
                    break
                await asyncio.sleep(0.5)
        finally:
            task.cancel()
    print(read, "of 60")
    assert read >= 50
