"""Channels that are scaled by their type code: while the unit refuses a code, and after somebody has set another."""

from collections.abc import Mapping
from contextlib import AbstractAsyncContextManager
from pathlib import Path

import pytest

from drivers.base import AsksLater, Driver, Quality, Refused, WrongDevice
from tests.benches.manual_clock import ManualClock
from tests.benches.own_profile import by_own_profile

pytestmark = pytest.mark.simulated_time

PROFILE = """
protocol = "modbus"
title = "Somebody's module"
buses = ["modbus_tcp"]
channels = 4
unit = "degC"
[value]
function = 4
address = 0
type = "uint16"
scaled_by = "type_code"
[type_code]
function = 3
address = 200
raw_low = 0
raw_high = 65535
code = [{ code = 0x03A4, low = -50, high = 150 }, { code = 0x03A2, low = -200, high = 200 }]
[[setting]]
function = 1
address = 268
equals = 1
name = "data format"
hint = "set it to engineering"
"""
RAW, DEGC = 22938, pytest.approx(20.0, abs=0.01)


class CodedModule:
    """Four inputs; it refuses what it `lacks`."""

    silent = False

    def __init__(self, *lacks: tuple[int, int]) -> None:
        self.lacks = set(lacks)
        self.code, self.format = 0x03A4, 1

    def memory(self, function: int) -> Mapping[int, int]:
        codes = dict.fromkeys(range(200, 204), self.code)
        words = {4: dict.fromkeys(range(4), RAW), 3: codes, 1: {268: self.format}}.get(function, {})
        return {address: word for address, word in words.items() if (function, address) not in self.lacks}


def reading(module: CodedModule, folder: Path, clock: ManualClock) -> AbstractAsyncContextManager[Driver]:
    return by_own_profile(module, folder, PROFILE, {f"c{i}": i for i in range(4)}, clock)


async def good(driver: Driver) -> dict[str, float]:
    return {reading.channel: reading.value for reading in await driver.read() if reading.quality is Quality.GOOD}


async def test_no_value_comes_unscaled_when_what_was_refused_is_asked_for_again(tmp_path: Path) -> None:
    """One channel's code and another channel's value are refused."""
    clock = ManualClock()
    async with reading(CodedModule((3, 201), (4, 3)), tmp_path, clock) as driver:
        for now_s in (0.0, 61.0, 62.0, 130.0):
            clock.move_to(now_s)
            assert await good(driver) == {"c0": DEGC, "c2": DEGC}, f"after {now_s} s"


async def test_a_refused_code_is_asked_for_again_after_a_minute(tmp_path: Path) -> None:
    module, clock = CodedModule((3, 201)), ManualClock()
    async with reading(module, tmp_path, clock) as driver:
        assert await good(driver) == {"c0": DEGC, "c2": DEGC, "c3": DEGC}
        module.lacks.clear()
        clock.move_to(50.0)
        assert "c1" not in await good(driver)
        clock.move_to(61.0)
        assert await good(driver) == {f"c{i}": DEGC for i in range(4)}


async def asked_later(driver: Driver, clock: ManualClock, now_s: float) -> bool:
    """Ask as the runner does when a period has time left."""
    assert isinstance(driver, AsksLater)
    clock.move_to(now_s)
    due = driver.asks_later
    if due:
        await driver.ask_later()
    return due


async def test_a_module_that_is_set_again_while_it_is_read_is_noticed(tmp_path: Path) -> None:
    module, clock = CodedModule(), ManualClock()
    async with reading(module, tmp_path, clock) as driver:
        assert [await asked_later(driver, clock, now_s) for now_s in (50.0, 61.0, 62.0, 122.0)] == [
            *(False, True),
            *(False, True),
        ]
        assert await good(driver) == {f"c{i}": DEGC for i in range(4)}, "nothing has changed"
        module.code = 0x03A2
        assert [await asked_later(driver, clock, now_s) for now_s in (183.0, 244.0)] == [True, True]
        assert await good(driver) == {f"c{i}": pytest.approx(-60.0, abs=0.01) for i in range(4)}
        module.format = 0
        assert await asked_later(driver, clock, 305.0)
        with pytest.raises(WrongDevice, match="data format is 0"):
            await driver.read()


async def test_a_module_that_refuses_its_codes_later_is_read_on(tmp_path: Path) -> None:
    module, clock = CodedModule(), ManualClock()
    async with reading(module, tmp_path, clock) as driver:
        module.lacks = {(3, 200 + i) for i in range(4)} | {(1, 268)}
        for now_s in (61.0, 122.0):
            with pytest.raises(Refused):
                await asked_later(driver, clock, now_s)
            assert await good(driver) == {f"c{i}": DEGC for i in range(4)}
