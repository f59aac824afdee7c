"""Modbus TCP hosts that close the connection: after each answer, when nobody asks for a while, or without an answer."""

import asyncio
import struct
from dataclasses import dataclass

import pytest

from drivers.base import ConnectError, Quality, Reading, SystemClock
from drivers.build import make_device
from drivers.modbus.numbers import Block
from gateway.acquisition.acquisition import Acquisition
from gateway.acquisition.line import Line
from gateway.model.notice import Notice
from gateway.runtime.clocks import RealClock
from tests.benches.modbus_host import modbus_host

pytestmark = pytest.mark.simulated_time

TWO = Block(4, 0, 2)
PERIOD_S, PERIODS, TIMEOUT_S = 1.0, 10, 0.4
_HEAD = struct.Struct(">HHHBBHH")


@dataclass
class ClosingHost:
    """Answers `answers` requests of a connection, register n holding 100 + n, and closes it after the last, or when it
    is idle. The connections numbered `mute` it closes at the first request."""

    answers: int = 1000
    idle_s: float = 1000.0
    mute: frozenset[int] = frozenset()
    opened: int = 0

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.opened += 1
        answers = 0 if self.opened in self.mute else self.answers
        try:
            for _ in range(answers):
                async with asyncio.timeout(self.idle_s):
                    request = await reader.readexactly(_HEAD.size)
                number, _, _, unit, function, first, count = _HEAD.unpack(request)
                data = b"".join((100 + first + i).to_bytes(2, "big") for i in range(count))
                pdu = bytes((unit, function, len(data))) + data
                writer.write(struct.pack(">HHH", number, 0, len(pdu)) + pdu)
            if not answers:
                await reader.readexactly(_HEAD.size)
        except (TimeoutError, asyncio.IncompleteReadError):
            pass
        finally:
            writer.close()


async def readings(host: ClosingHost) -> tuple[list[Reading], list[Notice]]:
    """What a gateway reads from the host in ten periods, and what it reports."""
    heard: list[Reading] = []
    notices: list[Notice] = []
    async with modbus_host(host.serve, TIMEOUT_S) as bus:
        channels = {"a": 0, "b": 1}
        driver = make_device("d", bus, "analogue_displacement", 1, channels, {}, SystemClock())
        async with Acquisition([Line(bus, (driver,), PERIOD_S)], RealClock(), heard.extend, notices.append):
            await asyncio.sleep((PERIODS - 0.5) * PERIOD_S)
    return heard, notices


async def test_every_period_is_read_of_a_host_that_closes_after_each_answer() -> None:
    host = ClosingHost(answers=1)
    heard, notices = await readings(host)
    assert [r.quality for r in heard] == [Quality.GOOD] * 2 * PERIODS
    assert notices == []
    assert host.opened == 1 + PERIODS, "one for each request: the test fetch, and each period"


async def test_every_period_is_read_of_a_host_that_closes_idle_connections() -> None:
    host = ClosingHost(idle_s=0.5)
    heard, notices = await readings(host)
    assert [r.quality for r in heard] == [Quality.GOOD] * 2 * PERIODS
    assert notices == []
    assert host.opened == PERIODS


async def test_a_host_that_keeps_the_connection_is_not_opened_again() -> None:
    host = ClosingHost()
    await readings(host)
    assert host.opened == 1


async def test_a_host_that_closes_without_an_answer_is_reported_after_one_more_attempt() -> None:
    host = ClosingHost(answers=0)
    async with modbus_host(host.serve, TIMEOUT_S) as bus:
        with pytest.raises(ConnectError, match="the device closed the connection"):
            await bus.read("d", 1, TWO)
        assert host.opened == 2


async def test_a_host_that_had_closed_and_closes_again_is_asked_on_a_third_connection() -> None:
    host = ClosingHost(answers=1, mute=frozenset({2}))
    async with modbus_host(host.serve, TIMEOUT_S) as bus:
        assert await bus.read("d", 1, TWO) == (100, 101)
        await asyncio.sleep(0.1)  # simulated: the closing arrives before the next request
        assert await bus.read("d", 1, TWO) == (100, 101)
        assert host.opened == 3


async def test_a_closed_bus_does_not_open_itself() -> None:
    host = ClosingHost()
    async with modbus_host(host.serve, TIMEOUT_S) as bus:
        assert await bus.read("d", 1, TWO) == (100, 101)
        await bus.close()
        with pytest.raises(ConnectError, match="not connected"):
            await bus.read("d", 1, TWO)
        assert host.opened == 1
