"""A unit that is silent for one address takes no time from the others on its line, and loses no other channel for long.

The gateway makes the lines from a configuration that states only what it must. Three units have two blocks
of registers each; one unit does not answer for the first of the two.
"""

import asyncio
import time
from collections.abc import Mapping, Sequence
from contextlib import AsyncExitStack
from pathlib import Path

import pytest

from drivers.base import Quality, Reading
from tests.benches.polled_three import MODBUS, PERIOD_S, UNITS, polled, started_line, worst

pytestmark = pytest.mark.simulated_time

PERIODS, MOST = 130, 0.2
SHORT, LONG = 2, 4
"""Registers of the silent block, and of the other: their answers differ in length."""
PROFILE = f"""
protocol = "modbus"
title = "two blocks"
buses = ["modbus_rtu", "modbus_tcp"]
unit = "1"
[[block]]
function = 3
address = 10
channels = {SHORT}
type = "uint16"
[[block]]
function = 3
address = 200
channels = {LONG}
type = "uint16"
"""


class TwoBlocks:
    """Registers that contain their own address; when the unit is mute it does not answer for those below 100."""

    silent = False

    def __init__(self) -> None:
        self.mute = False
        self.waited: list[float] = []
        """When the silent block was asked for."""
        self._drops = False

    def memory(self, function: int) -> Mapping[int, int]:
        return _MutedRegisters(self)

    def touched(self, address: int) -> int:
        self._drops = self.mute and address < 100
        if self._drops:
            self.waited.append(time.monotonic())
        return address

    def spoil(self, frame: bytes) -> Sequence[tuple[float, bytes]]:
        return () if self._drops else ((0.0, frame),)


class _MutedRegisters(dict[int, int]):
    def __init__(self, unit: TwoBlocks) -> None:
        super().__init__()
        self._unit = unit

    def __missing__(self, address: int) -> int:
        return self._unit.touched(address)


CHANNELS = "{ muteUNIT = 0, mute_tooUNIT = 1, loudUNIT = 2 }"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "mute", "begins"),
    [
        *((kind, unit, "falls silent") for kind, unit in zip(MODBUS, UNITS, strict=True)),
        *((kind, unit, "silent from the start") for kind, unit in zip(MODBUS, reversed(UNITS), strict=True)),
    ],
)
async def test_one_address_of_one_unit(kind: str, mute: int, begins: str, tmp_path: Path) -> None:
    readings: list[Reading] = []
    units = {unit: TwoBlocks() for unit in UNITS}
    units[mute].mute = begins == "silent from the start"
    async with AsyncExitStack() as stack:
        line, fields = await started_line(kind, units, stack)
        line.spoil = lambda unit, frame: units[unit].spoil(frame)
        (tmp_path / "two.toml").write_text(PROFILE)
        async with polled(fields, 'profile = "two.toml"', CHANNELS, tmp_path, readings):
            began_s = time.monotonic()
            await asyncio.sleep(9.5 * PERIOD_S)
            units[mute].mute = True
            silent_s = time.monotonic()
            await asyncio.sleep(PERIODS * PERIOD_S)
            ended_s = time.monotonic()
            units[mute].mute = False
            await asyncio.sleep(62 * PERIOD_S)
    since_s = began_s + (1.5 * PERIOD_S if begins == "silent from the start" else 0.0)
    others = {unit: worst(readings, f"loud{unit}", since_s) for unit in UNITS if unit != mute}
    own = [r.quality for r in readings if r.channel == f"loud{mute}"]
    asked = [at for at in units[mute].waited if at >= silent_s + 10 * PERIOD_S]
    print(kind, mute, begins, "others", others, "own lost", own.count(Quality.COMM_FAULT), "asked", len(asked))
    assert max(others.values()) <= MOST
    assert own.count(Quality.COMM_FAULT) <= 4, "of the unit's other block, and only at first"
    assert set(own[-PERIODS:]) == {Quality.GOOD}
    lost = [r for r in readings if r.channel == f"mute{mute}" and silent_s + 10.0 <= r.monotonic_s < ended_s]
    assert {r.quality for r in lost} == {Quality.COMM_FAULT}
    assert all("unit " in r.detail and "does not answer function 3, address 10, count 1" in r.detail for r in lost)
    assert len(asked) <= 2 * 10, "each of its two registers after 8, 16, 32 and 60 s"
    assert [r.quality for r in readings if r.channel == f"mute{mute}"][-1] is Quality.GOOD, "it came back"
