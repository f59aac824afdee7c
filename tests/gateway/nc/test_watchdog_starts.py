"""A few of the starts of tests/benches/watchdog_starts.py, whose command makes many more."""

import pytest

from tests.benches.nc_disturbances import PERIOD_S, SLEW_UM_PER_S
from tests.benches.watchdog_starts import starts

pytestmark = pytest.mark.simulated_time

TOLD = ("no start", "ends", "loses an action", "power, no start")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("route", "seed"),
    [
        ("k0", 2),
        pytest.param("r", 3, marks=pytest.mark.slow),
        pytest.param("k0_slope", 4, marks=pytest.mark.slow),
        pytest.param("errors", 5, marks=pytest.mark.slow),
    ],
)
async def test_without_a_complete_watchdog_nothing_is_written_and_it_is_said(route: str, seed: int) -> None:
    found = await starts(route, 4, seed, kinds=TOLD)
    assert sum(found.without.values()) == 0
    assert found.told == dict.fromkeys(TOLD, 1)
    assert found.writes > 20, "while there was one"
    assert found.moved_um > 1.0


@pytest.mark.slow
@pytest.mark.parametrize("route", ["k0", "errors"])
async def test_whatever_happens_to_the_control_nothing_steps_and_after_a_kill_nothing_stays(route: str) -> None:
    found = await starts(route, 5, 6, kinds=("reset", "end of program", "inch program", "emergency stop", "power"))
    assert found.moved_um > 1.0
    assert found.left_um < 1e-6
    assert found.largest_um <= SLEW_UM_PER_S * PERIOD_S * (1 + 1e-6)
    assert sum(found.told.values()) == 0
