"""A few of the disturbances of tests/benches/nc_disturbances.py; many more by its command."""

import pytest

from tests.benches.nc_disturbances import KINDS, PERIOD_S, SLEW_UM_PER_S, disturbed

pytestmark = [pytest.mark.slow, pytest.mark.simulated_time]


async def test_whatever_happens_to_gateway_and_line_nothing_moves_farther_in_a_period_than_the_slew_allows() -> None:
    found = await disturbed("errors", len(KINDS), 5)
    assert set(found.counts) == set(KINDS)
    assert max(found.largest_um.values()) <= SLEW_UM_PER_S * PERIOD_S * (1 + 1e-9)
    assert found.moved_um > 3.0, "what stands at zero cannot step"
    assert found.disarmed == 0


async def test_the_record_shows_a_step_where_the_control_does_not_slew() -> None:
    found = await disturbed("k0", 1, 5, kinds=("late",), late_s=(30.0, 40.0))
    assert found.largest_um["late"] > SLEW_UM_PER_S * PERIOD_S * 1.5
