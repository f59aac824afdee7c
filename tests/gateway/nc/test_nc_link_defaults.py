"""The link with the limits of a new configuration: nothing of the compensation is set but its mode."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from gateway.model.compensation import Source
from tests.benches.nc_link_bench import LinkBench, answer_wrongly, decision


async def test_a_decision_counts_for_a_quarter_of_an_hour_and_then_goes_to_zero() -> None:
    bench = LinkBench("compensate", shipped=True)
    async with bench.running():
        bench.link.follow(decision(4.0))
        await bench.clock.run_until(899.0)
        assert bench.control.in_force == (0.0, 0.0, 4.0)
        await bench.clock.run_until(910.0)
        assert bench.control.in_force == (0.0, 0.0, 0.0)
    assert bench.steps[-1].step.source is Source.STALE


async def test_no_offset_goes_beyond_50_micrometres_nor_faster_than_one_a_second() -> None:
    bench = LinkBench("compensate", shipped=True)
    async with bench.running():
        bench.link.follow(decision(80.0))
        await bench.clock.run_until(40.0)
        assert 35.0 <= bench.control.in_force[2] <= 40.0
        await bench.clock.run_until(100.0)
        assert bench.control.in_force == (0.0, 0.0, 50.0)
    z = [0.0, *(offsets[2] for _, offsets in bench.control.writes)]
    assert max(abs(b - a) for a, b in pairwise(z)) <= 1.0 + 1e-9


async def test_an_axis_that_should_move_and_stands_still_is_frozen_after_two_minutes() -> None:
    bench = LinkBench("monitor", shipped=True)
    async with bench.running():
        answer_wrongly(bench, "snapshot", lambda s: replace(s, states=dict(s.states) | {"speed_X": 500.0}))
        await bench.clock.run_until(119.0)
        passed_on = len(bench.states)
        assert passed_on >= 118
        await bench.clock.run_until(130.0)
        assert len(bench.states) - passed_on <= 3


async def test_an_error_without_a_model_is_corrected_by_its_last_measurement_for_sixteen_hours() -> None:
    bench = LinkBench("compensate", shipped=True, measured=[40.0 - 57600.0] * 9)
    known = replace(decision(7.0), predicted=np.array([3.0, *[math.nan] * 8]))
    known.corrected[0] = 3.0
    async with bench.running():
        bench.link.follow(known)
        await bench.clock.run_until(39.0)
        assert bench.control.in_force == pytest.approx((0.0, 3.0, 7.0))
        await bench.clock.run_until(60.0)
        assert bench.control.in_force == pytest.approx((0.0, 3.0, 0.0))
