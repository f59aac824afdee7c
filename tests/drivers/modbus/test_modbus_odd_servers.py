"""Servers with one fault each, beside a unit without: what they cost, and what is reported about them."""

import asyncio
import struct
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from drivers.base import Bus, Quality, Reading, SystemClock
from drivers.build import make_device
from gateway.acquisition.acquisition import Acquisition
from gateway.acquisition.line import Line
from gateway.runtime.clocks import RealClock
from tests.benches.modbus_host import modbus_host
from tests.benches.rtu_talk import frame, line

pytestmark = pytest.mark.simulated_time

PERIOD_S, TIMEOUT_S, CHANNELS = 1.0, 0.4, 12
PROFILE = """
protocol = "modbus"
title = "Somebody's module"
buses = ["modbus_tcp", "modbus_rtu"]
unit = "degC"
[[block]]
function = 3
address = 0
channels = 12
type = "int16"
scale = 0.1
"""
ODD, GOOD = 1, 2
Odd = Callable[[int, bytes], Sequence[tuple[float, bytes]]]
"""From the number of the request, and the right answer's message, to the messages that are sent, and how late."""


def right(unit: int, request: bytes) -> bytes:
    """Register n of unit u contains 1000 u + n. request: function, first address, count"""
    function, first, count = struct.unpack(">BHH", request)
    return bytes((function, 2 * count)) + struct.pack(f">{count}H", *(1000 * unit + first + n for n in range(count)))


async def read_over_tcp(odd: Odd, folder: Path, periods: int, units: Sequence[int]) -> tuple[list[Reading], list[str]]:
    asked = 0

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        nonlocal asked
        while True:
            number, _, length, unit = struct.unpack(">HHHB", await reader.readexactly(7))
            message = right(unit, await reader.readexactly(length - 1))
            asked += unit == ODD
            for late_s, told in odd(asked, message) if unit == ODD else [(0.0, message)]:
                answer = struct.pack(">HHHB", number, 0, len(told) + 1, unit) + told
                asyncio.get_running_loop().call_later(late_s, writer.write, answer)

    async with modbus_host(serve, TIMEOUT_S) as bus:
        return await _read(bus, folder, periods, units)


async def read_over_rtu(odd: Odd, folder: Path, periods: int, units: Sequence[int]) -> tuple[list[Reading], list[str]]:
    asked = 0

    async with line(TIMEOUT_S) as (bus, peer):

        def reply(request: bytes) -> bytes:
            nonlocal asked
            unit, message = request[0], right(request[0], request[1:-2])
            asked += unit == ODD
            for late_s, told in odd(asked, message) if unit == ODD else [(0.0, message)]:
                asyncio.get_running_loop().call_later(late_s, peer.port.write, frame(bytes((unit,)) + told))
            return b""

        peer.reply = reply
        return await _read(bus, folder, periods, units)


async def _read(bus: Bus, folder: Path, periods: int, units: Sequence[int]) -> tuple[list[Reading], list[str]]:
    profile = folder / "module.toml"
    profile.write_text(PROFILE)
    heard: list[Reading] = []
    told: list[str] = []
    drivers = tuple(
        make_device(f"d{unit}", bus, str(profile), unit, {f"{unit}.{n}": n for n in range(CHANNELS)}, {}, SystemClock())
        for unit in units
    )
    wire = Line(bus, drivers, PERIOD_S)
    async with Acquisition([wire], RealClock(), heard.extend, lambda notice: told.append(notice.text)):
        await asyncio.sleep((periods - 0.5) * PERIOD_S)
    for reading in heard:
        unit, number = map(int, reading.channel.split("."))
        if reading.quality.usable:
            assert reading.value == pytest.approx((1000 * unit + number) / 10), "no value is ever wrong"
        if unit == GOOD:
            assert reading.quality is Quality.GOOD, reading
    return heard, told


WIRES = {"tcp": read_over_tcp, "rtu": read_over_rtu}


def of_the_odd_one(heard: Sequence[Reading], from_period: int = 0) -> set[Quality]:
    first_s = heard[0].monotonic_s
    return {
        r.quality
        for r in heard
        if r.channel.startswith(f"{ODD}.") and r.monotonic_s >= first_s + from_period * PERIOD_S
    }


@pytest.mark.parametrize("wire", WIRES)
@pytest.mark.parametrize("first", [0, 1])
async def test_one_that_answers_every_second_request_is_read_in_every_period(
    wire: str, first: int, tmp_path: Path
) -> None:
    """Even if each time the check is answered and the reading is not."""
    heard, told = await WIRES[wire](lambda n, right: [(0.0, right)] * ((n + first) % 2), tmp_path, 8, (ODD, GOOD))
    assert of_the_odd_one(heard, 1) == {Quality.GOOD}
    assert len(told) <= 2, "at the beginning"


@pytest.mark.parametrize("units", [(ODD, GOOD), (ODD,)])
@pytest.mark.parametrize("wire", WIRES)
async def test_one_that_always_answers_later_than_the_timeout_is_read_and_told_what_to_set(
    wire: str, units: Sequence[int], tmp_path: Path
) -> None:
    """A device that is heard is not dead: it is asked in every period, and its late answer is as good."""
    heard, told = await WIRES[wire](lambda _, right: [(TIMEOUT_S + 0.05, right)], tmp_path, 12, units)
    assert of_the_odd_one(heard, 8) == {Quality.GOOD}
    assert told[-1:] in ([], ["device d1: answers again"])


@pytest.mark.parametrize("wire", WIRES)
async def test_one_that_is_later_than_the_period_is_told_what_to_set(wire: str, tmp_path: Path) -> None:
    heard, told = await WIRES[wire](lambda _, right: [(1.3 * PERIOD_S, right)], tmp_path, 12, (ODD, GOOD))
    assert of_the_odd_one(heard) == {Quality.COMM_FAULT}
    details = {reading.detail for reading in heard if reading.channel == f"{ODD}.0"}
    assert any("raise timeout_s" in detail for detail in details), details
    assert all("bus bus1, device d1: " in text for text in told if "answers again" not in text)


SPOILT: dict[str, Callable[[bytes], bytes]] = {
    "another function": lambda right: bytes((7 - right[0],)) + right[1:],
    "fewer registers": lambda right: bytes((right[0], right[1] - 2)) + right[2:-2],
    "more registers": lambda right: bytes((right[0], right[1] + 2)) + right[2:] + b"\0\0",
    "a count that is too low": lambda right: bytes((right[0], right[1] - 2)) + right[2:],
    "a count that is too high": lambda right: bytes((right[0], right[1] + 2)) + right[2:],
    "a count of words": lambda right: bytes((right[0], right[1] // 2)) + right[2:],
    "its request": lambda _: struct.pack(">BHH", 3, 0, CHANNELS),
    "a writing's answer": lambda _: struct.pack(">BHH", 6, 0, CHANNELS),
    "a refusal that is too long": lambda right: bytes((right[0] | 0x80, 2, 0)),
    "text": lambda _: b"ERROR 42\r\n",
}


@pytest.mark.parametrize("how", SPOILT)
@pytest.mark.parametrize("wire", WIRES)
async def test_what_does_not_fit_the_request_is_not_a_value_and_is_reported(
    wire: str, how: str, tmp_path: Path
) -> None:
    heard, told = await WIRES[wire](lambda _, right: [(0.0, SPOILT[how](right))], tmp_path, 6, (ODD, GOOD))
    assert of_the_odd_one(heard) == {Quality.COMM_FAULT}
    if (wire, how) == ("rtu", "its request"):
        assert told[0].endswith("did not answer within 0.4 s (check power, wiring, unit id and baud)"), "as an echo"
        return
    text = told[0]
    assert text.startswith("bus bus1, device d1: the answer does not fit function 3, count ")
    assert text.endswith("(does the profile fit the device?)")
