"""Odd wires with third-party programs at their far end: an adapter that echoes, a disturbed line, a host that
closes."""

import asyncio
import random

import pytest

from drivers.base import BadAnswer, NoAnswer, Quality, SystemClock
from drivers.build import make_device
from drivers.modbus.numbers import Block
from tests.benches.asked_again import LIMIT_S, answered
from tests.benches.buses import make_bus
from tests.benches.libmodbus_line import TIMEOUT_S, UNIT, libmodbus_line
from tests.benches.npm_peer import node_with, running

pytestmark = pytest.mark.peer

VALUES = Block(4, 0, 6)
ITS_OWN = Block(2, 0x0300, 17)
"""This request is a valid answer to itself, of other bits than libmodbus has."""
TRUE_BITS = (1,) + (0,) * 15 + (1,)
TRUE_WORDS = (200, 213, 0xFFDF, 400, 0x7FFF, 222)


async def test_libmodbus_is_read_behind_an_adapter_that_echoes() -> None:
    arrived = bytearray()

    def heard(data: bytes) -> bytes:
        arrived.extend(data)
        return data

    async with libmodbus_line(heard, echoes=True) as bus:
        for _ in range(3):
            assert await answered(lambda again: bus.read("d", UNIT, VALUES, again=again)) == TRUE_WORDS
            assert await answered(lambda again: bus.read("d", UNIT, ITS_OWN, again=again)) == TRUE_BITS
    assert arrived.count(bytes((UNIT, 4, 0, 0, 0, 6))) >= 3, "the requests came back"


async def test_libmodbus_is_read_over_a_line_that_flips_bits() -> None:
    """In a third of its answers: no value is wrong, and none is lost if it is asked for again."""
    draw, flipped = random.Random(0), 0

    def heard(data: bytes) -> bytes:
        nonlocal flipped
        if draw.random() > 0.3:
            return data
        flipped += 1
        spoilt = bytearray(data)
        bit = draw.randrange(8 * len(data))
        spoilt[bit // 8] ^= 1 << bit % 8
        return bytes(spoilt)

    async with libmodbus_line(heard) as bus, asyncio.timeout(LIMIT_S):
        for _ in range(60):
            for again in (False, *[True] * 7):  # as often as the gateway asks a device that it hears
                try:
                    words = await bus.read("d", UNIT, VALUES, again=again)
                except (BadAnswer, NoAnswer):
                    continue
                break
            else:
                pytest.fail("not answered in eight attempts")
            assert words == TRUE_WORDS
    assert flipped >= 10


async def test_a_host_of_another_stack_that_closes_after_each_answer() -> None:
    """modbus-serial on Node.js, which ends its connection."""
    node = node_with("modbus_serial", "modbus-serial")
    opened = 0

    class Tap:
        def data(self, sent: bool, data: bytes) -> None: ...

        def frame(self, sent: bool, identifier: int, extended: bool, data: bytes) -> None: ...

        def note(self, text: str) -> None:
            nonlocal opened
            opened += "open" in text

    async with running(node, "modbus_serial/server.js", "closing") as (port, _):
        options = {"host": "127.0.0.1", "port": int(port), "timeout_s": TIMEOUT_S}
        bus = make_bus("tcp1", "modbus_tcp", options, Tap())
        driver = make_device("rtd", bus, "advantech_adam6015", 1, {f"c{i}": i for i in range(7)}, {}, SystemClock())
        try:
            await bus.connect()
            await driver.connect()
            for _ in range(3):
                readings = await driver.read()
                assert [r.value for r in readings[:5]] == pytest.approx([50.0, 0.0, 100.0, -49.997, 149.997], abs=0.003)
                assert [r.quality for r in readings[:5]] == [Quality.GOOD] * 5
        finally:
            await driver.close()
            await bus.close()
    assert opened >= 6, "one connection for each request"
