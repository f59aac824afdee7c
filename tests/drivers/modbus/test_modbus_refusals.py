"""Units that refuse more than the standard says, or only for a while. The host is the test's own."""

import asyncio
import struct
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from drivers.base import Busy, NoAnswer, Quality, Reading, SystemClock
from drivers.build import make_device
from drivers.modbus.numbers import Block
from gateway.acquisition.acquisition import Acquisition
from gateway.acquisition.line import Line
from gateway.commissioning.scan.registers import read_words
from gateway.model.notice import Notice
from gateway.runtime.clocks import RealClock
from tests.benches.modbus_host import modbus_host

pytestmark = pytest.mark.simulated_time

PERIOD_S, TIMEOUT_S = 1.0, 0.4
_HEAD = struct.Struct(">HHHBBHH")
PROFILE = """
protocol = "modbus"
title = "Somebody's module"
buses = ["modbus_tcp"]
unit = "degC"
[[block]]
function = 3
address = 0
channels = 30
type = "int16"
scale = 0.1
"""
SILENT = -1
Refuse = Callable[[int, int], int]
"""From first address and count to the exception code; 0: answered; SILENT: not at all."""


class RefusingHost:
    """Register n contains n; `refuse` says what is refused."""

    def __init__(self, refuse: Refuse) -> None:
        self.refuse = refuse
        self.asked: list[tuple[float, int, int]] = []
        """When, first address and count."""

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while True:
            number, _, _, unit, function, first, count = _HEAD.unpack(await reader.readexactly(_HEAD.size))
            self.asked.append((asyncio.get_running_loop().time(), first, count))
            if (code := self.refuse(first, count)) == SILENT:
                continue
            if code:
                pdu = bytes((unit, function | 0x80, code))
            else:
                pdu = bytes((unit, function, 2 * count)) + struct.pack(f">{count}H", *range(first, first + count))
            writer.write(struct.pack(">HHH", number, 0, len(pdu)) + pdu)


async def readings(refuse: Refuse, folder: Path, periods: int) -> tuple[list[Reading], list[Notice], RefusingHost]:
    """What a gateway reads of thirty channels, and what it reports."""
    profile = folder / "module.toml"
    profile.write_text(PROFILE)
    host = RefusingHost(refuse)
    heard: list[Reading] = []
    notices: list[Notice] = []
    async with modbus_host(host.serve, TIMEOUT_S) as bus:
        channels = {f"c{number}": number for number in range(30)}
        driver = make_device("d", bus, str(profile), 1, channels, {}, SystemClock())
        async with Acquisition([Line(bus, (driver,), PERIOD_S)], RealClock(), heard.extend, notices.append):
            await asyncio.sleep((periods - 0.5) * PERIOD_S)
    return heard, notices, host


def are_right(heard: Sequence[Reading]) -> bool:
    return all(reading.value == pytest.approx(int(reading.channel[1:]) / 10) for reading in heard)


@pytest.mark.parametrize("code", [2, 3])
async def test_a_unit_that_answers_with_sixteen_registers_at_most_is_read_in_parts(code: int, tmp_path: Path) -> None:
    heard, notices, host = await readings(lambda _, count: code if count > 16 else 0, tmp_path, 5)
    assert {reading.quality for reading in heard} == {Quality.GOOD}
    assert are_right(heard)
    assert notices == []
    assert max(count for at_s, _, count in host.asked if at_s > host.asked[0][0] + 2) <= 16, "it is known by then"


@pytest.mark.parametrize("code", [0x04, 0x08, 0xFF])
async def test_an_address_that_fails_takes_its_own_channel_only_whatever_the_code(code: int, tmp_path: Path) -> None:
    def refuse(first: int, count: int) -> int:
        return code if first <= 7 < first + count else 0

    heard, notices, _ = await readings(refuse, tmp_path, 5)
    assert {r.channel for r in heard if r.quality is not Quality.GOOD} == {"c7"}
    assert are_right([reading for reading in heard if reading.channel != "c7"])
    assert [f"address 7, count 1 with exception {code}" in notice.text for notice in notices] == [True]


async def test_a_failure_of_a_moment_takes_one_period_and_no_channel_for_longer(tmp_path: Path) -> None:
    """A unit that has answered before and fails is asked again before its request is divided."""
    began_s = asyncio.get_running_loop().time()

    def refuse(_first: int, _count: int) -> int:
        return 4 if 3.9 < asyncio.get_running_loop().time() - began_s < 4.9 else 0

    heard, notices, _ = await readings(refuse, tmp_path, 8)
    times = sorted({reading.monotonic_s for reading in heard})
    assert [{r.quality for r in heard if r.monotonic_s == at} for at in times] == [
        {Quality.COMM_FAULT} if number == 4 else {Quality.GOOD} for number in range(8)
    ]
    assert [notice.ended for notice in notices] == [False, True]


async def test_a_busy_unit_is_asked_again_later_in_the_same_period(tmp_path: Path) -> None:
    """In every period it is busy for 300 ms (exceptions 5 and 6), and the rests between the requests grow."""
    began_s = asyncio.get_running_loop().time()

    def refuse(first: int, _count: int) -> int:
        return 5 + first % 2 if (asyncio.get_running_loop().time() - began_s) % PERIOD_S < 0.3 else 0

    heard, notices, host = await readings(refuse, tmp_path, 6)
    assert {reading.quality for reading in heard} == {Quality.GOOD}
    assert are_right(heard)
    assert notices == []
    in_one = [at_s - began_s - 3 for at_s, _, _ in host.asked if 2.95 < at_s - began_s < 3.95]
    assert in_one == pytest.approx([0, 0.05, 0.15, 0.35], abs=0.02)


async def test_a_unit_that_stays_busy_says_so_and_is_read_as_soon_as_it_can_be(tmp_path: Path) -> None:
    began_s = asyncio.get_running_loop().time()
    heard, notices, host = await readings(
        lambda *_: 6 if asyncio.get_running_loop().time() - began_s < 4.5 else 0, tmp_path, 7
    )
    first_good_s = min(r.monotonic_s for r in heard if r.quality is Quality.GOOD)
    assert first_good_s - heard[0].monotonic_s < 5.0
    assert "with exception 6: device busy (ask it less often" in notices[0].text
    assert [notice.ended for notice in notices] == [False, True]
    assert len(host.asked) <= 8 * 5 + 3


async def test_a_request_alone_says_that_the_unit_is_busy() -> None:
    async with modbus_host(RefusingHost(lambda *_: 6).serve, TIMEOUT_S) as bus:
        with pytest.raises(Busy, match="exception 6"):
            await bus.read("d", 1, Block(3, 0, 2))


async def test_inspect_waits_for_a_busy_unit() -> None:
    answers = iter([6, 6, 6, 0, 6, 0])
    async with modbus_host(RefusingHost(lambda *_: next(answers, 0)).serve, TIMEOUT_S) as bus:
        seen = await read_words(bus, 1, 3, (0, 1, 5))
    assert seen.words == {0: 0, 1: 1, 5: 5}
    assert not seen.refused


async def test_a_unit_that_is_silent_when_a_gap_is_read_is_reported_with_the_gap(tmp_path: Path) -> None:
    profile = tmp_path / "module.toml"
    profile.write_text(PROFILE.replace("address = 0\nchannels = 30", "addresses = [0, 1, 20, 24]"))
    host = RefusingHost(lambda first, count: SILENT if first <= 22 < first + count else 0)
    async with modbus_host(host.serve, TIMEOUT_S) as bus:
        driver = make_device("d", bus, str(profile), 1, {"a": 0, "b": 2, "c": 3}, {}, SystemClock())
        await driver.connect()
        with pytest.raises(NoAnswer, match=r"this one also reads 21-23, which no channel needs: max_gap = 0\?"):
            await driver.read()
        profile.write_text(profile.read_text().replace("[[block]]", "max_gap = 0\n[[block]]"))
        driver = make_device("d", bus, str(profile), 1, {"a": 0, "b": 2, "c": 3}, {}, SystemClock())
        assert [reading.value for reading in await driver.read()] == pytest.approx([0.0, 2.0, 2.4])
