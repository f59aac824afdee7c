"""A plain Modbus client: one request after the other on one connection, each waited for 5 s. What it can read, the
gateway must."""

import asyncio
from collections.abc import Mapping, Sequence
from math import ceil

from simulators.devices.modbus_servers import crc16
from tests.benches.strangers.driven_loop import DrivenLoop, Line
from tests.benches.strangers.modbus_nature import Nature, age_s, told

_PATIENCE_S = 5.0
_STEP_S = 0.02
"""Of the registers' time."""

Wanted = tuple[int, int, int, int]
"""Unit, function, address, count."""


class _Ear(asyncio.Protocol):
    def __init__(self) -> None:
        self.heard, self.is_open, self.told = bytearray(), True, asyncio.Event()

    def data_received(self, data: bytes) -> None:
        self.heard += data
        self.told.set()

    def connection_lost(self, _: Exception | None) -> None:
        self.is_open = False
        self.told.set()


async def plainly_read(
    loop: DrivenLoop,
    nature: Nature,
    asked: Sequence[Wanted],
    numbers: Mapping[Wanted, int],
    lasts_s: float,
    *,
    ignores_numbers: bool = False,
) -> list[dict[int, float]]:
    """For each round the units of which every request was answered with what the device measured since it was sent, and
    how long after the round was due that was.

    numbers: of the first register that each one reads
    """
    began_s, number = loop.time(), 0
    ear: _Ear | None = None
    line: Line | None = None
    rounds: list[dict[int, float]] = []
    due_s = began_s
    while loop.time() < began_s + lasts_s:
        await asyncio.sleep(max(0.0, due_s - loop.time()))
        read = dict.fromkeys((one[0] for one in asked), 0.0)
        rounds.append(read)
        for one in asked:
            if ear is None or not ear.is_open:
                try:
                    line, ear = await loop.create_connection(_Ear, "host", 502)
                except ConnectionRefusedError:
                    ear = None
                    read.pop(one[0], None)
                    continue
            assert ear is not None
            assert line is not None
            number = number % 0xFFFF + 1
            ear.heard.clear()
            sent_s = loop.time()
            line.write(_request(nature, number, one))
            word = await _answered(loop, ear, nature, None if ignores_numbers else number, one)
            took_s = loop.time() - sent_s
            if word is None or told(word)[:2] != (one[0], numbers[one]) or age_s(word, loop.time()) > took_s + _STEP_S:
                read.pop(one[0], None)
            elif one[0] in read:
                read[one[0]] = loop.time() - due_s
        due_s += nature.period_s * max(1, ceil((loop.time() - due_s) / nature.period_s))
    if line is not None:
        line.close()
    return rounds


async def _answered(loop: DrivenLoop, ear: _Ear, nature: Nature, number: int | None, one: Wanted) -> int | None:
    """The first word of the answer."""
    until_s = loop.time() + _PATIENCE_S
    while True:
        if (found := _found(bytes(ear.heard), nature, number, one)) is not None:
            return found
        if not ear.is_open or loop.time() >= until_s:
            return None
        ear.told.clear()
        try:
            async with asyncio.timeout_at(until_s):
                await ear.told.wait()
        except TimeoutError:
            return None


def _request(nature: Nature, number: int, one: Wanted) -> bytes:
    unit, function, address, count = one
    body = bytes((unit, function)) + address.to_bytes(2, "big") + count.to_bytes(2, "big")
    if nature.wire == "rtu":
        return body + crc16(body)
    return number.to_bytes(2, "big") + bytes((0, 0, 0, len(body))) + body


def _found(heard: bytes, nature: Nature, number: int | None, one: Wanted) -> int | None:
    unit, function, _, count = one
    body = bytes((unit, function, 2 * count))
    length = 3 + 2 * count
    mark = b"" if number is None else number.to_bytes(2, "big")
    head = b"" if nature.wire == "rtu" else mark + bytes((0, 0, 0, length))
    at = heard.find(head + body)
    if at < 0:
        return None
    frame = heard[at + len(head) : at + len(head) + length]
    rest = heard[at + len(head) + length :][:2]
    if len(frame) < length or (nature.wire == "rtu" and crc16(frame) != rest):
        return None
    return int.from_bytes(frame[3:5], "big")
