"""How a bus is polled if the configuration says only where it is."""

import asyncio
from itertools import pairwise

import pytest

from drivers.base import NoAnswer
from gateway.acquisition.build import lines_of
from gateway.acquisition.line import Line
from gateway.config.extended import validate
from tests.benches.scripted_bus import ScriptedPlant
from tests.benches.stepped_clock import SteppedClock

pytestmark = pytest.mark.simulated_time


def shipped() -> Line:
    config = validate(
        {
            "machine": {"name": "mill"},
            "bus": [{"name": "tcp1", "kind": "modbus_tcp", "host": "nowhere"}],
            "device": [
                {"name": "adam", "bus": "tcp1", "profile": "advantech_adam6015", "channels": {"bed": 0}},
            ],
        }
    )
    (line,) = lines_of(config, SteppedClock())
    return line


async def test_a_dead_device_is_asked_after_a_minute_at_the_latest() -> None:
    line, plant = shipped(), ScriptedPlant("a", "b")
    assert line.period_s == 1.0
    plant.devices["a"].fault = NoAnswer("silent")
    async with plant.running(retry_max_periods=line.retry_max_periods):
        await plant.clock.run_until(260.0)
        asked = sorted(set(plant.devices["a"].asked))
    assert [round(b - a) for a, b in pairwise(asked)][-2:] == [60, 60]


async def test_a_read_that_hangs_is_given_up_after_ten_seconds() -> None:
    line, plant = shipped(), ScriptedPlant("a")
    plant.devices["a"].hang = True
    async with plant.running(read_limit_s=line.read_limit_s):
        await plant.clock.run_until(0.5)
        await asyncio.sleep(9.9)
        assert plant.notices == []
        await asyncio.sleep(0.2)
        assert ["did not finish within 10 s" in notice.text for notice in plant.notices] == [True]


def test_a_scan_reads_what_it_found_as_a_configuration_that_states_nothing() -> None:
    line = shipped()
    found = Line(line.bus, line.drivers)  # as a scan makes it
    for polled in (line, found):
        assert (polled.period_s, polled.retry_max_periods, polled.read_limit_s) == (1.0, 60, 10.0)
