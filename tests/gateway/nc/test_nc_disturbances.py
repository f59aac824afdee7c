"""A few of the disturbances of tests/benches/nc_disturbances.py, whose command runs many more."""

import pytest

from simulators.nc import Activity, DayPart, LoadCase, MeanLoads, Nck
from tests.benches.emulated_bench import Rigid
from tests.benches.nc_disturbances import (
    KINDS,
    PERIOD_S,
    SLEW_UM_PER_S,
    ShiftRecord,
    disturbed,
    largest_changes,
)


@pytest.mark.slow
@pytest.mark.simulated_time
async def test_whatever_happens_to_gateway_and_connection_nothing_moves_farther_in_a_period_than_the_slew_allows() -> (
    None
):
    found = await disturbed("errors", len(KINDS), 5)
    assert set(found.counts) == set(KINDS)
    assert max(found.largest_um.values()) <= SLEW_UM_PER_S * PERIOD_S * (1 + 1e-9)
    assert found.moved_um > 3.0, "an offset of zero cannot step"
    assert found.disarmings == ()


@pytest.mark.slow
@pytest.mark.simulated_time
async def test_where_the_control_does_not_slew_a_write_that_the_network_holds_makes_no_step_either() -> None:
    found = await disturbed("k0", 1, 5, kinds=("late",), late_s=(30.0, 40.0))
    assert found.largest_um["late"] <= SLEW_UM_PER_S * PERIOD_S * (1 + 1e-9)
    assert found.moved_um > 3.0
    assert found.disarmings == ()


def test_the_record_shows_a_step_and_a_slope_where_it_is_largest() -> None:
    nck = Nck(Rigid(), LoadCase([DayPart(0.0, 1e6, Activity.PAUSE, MeanLoads())]))
    record = ShiftRecord(nck)
    nck.write_k0(0, 0.003, 5.0)
    nck.slope[1] = 1e-5  # 2 µm at the end of the travel
    nck.write_k0(0, 0.0035, 15.0)
    largest, moved = largest_changes(record, [(1.0, "step"), (10.0, "slope")], (0.0, 20.0))
    assert largest == pytest.approx({"step": 3.0, "slope": 2.0})
    assert moved == pytest.approx(3.5)
