"""Some of the disturbances of tests.benches.linuxcnc_foreign. Needs Debian's linuxcnc-uspace."""

import random
from pathlib import Path

import numpy as np
import pytest

from drivers.base import Refused
from drivers.nc import ProbingState
from tests.benches.linuxcnc_bench import until
from tests.benches.linuxcnc_foreign import BALL_MM, FINAL, KINDS, SIGNALS, distances, disturbable, disturbed

pytestmark = [pytest.mark.peer, pytest.mark.slow]

LEAST_MM = 15.0
"""BALL and twice REACH of the bench's machine."""
REASONS = {
    "block": "somebody else moved the machine or changed its modes",
    "mdi": "somebody else moved the machine or changed its modes",
    "mode": "somebody changed the operating mode",
    "limit": "the machine is off or not homed",
}


async def test_a_cycle_that_was_not_alone_has_no_result_and_leaves_the_probe_safe(tmp_path: Path) -> None:
    draw = random.Random(7)
    async with disturbable(tmp_path) as bench:
        for number, kind in enumerate(("block", "mdi", "mode", "limit", "contact"), start=1):
            assert kind in KINDS
            one = await disturbed(bench, kind, number, draw)
            assert one.safe, one
            assert kind not in REASONS or one.status.reason == REASONS[kind]


async def test_a_dry_run_goes_the_path_above_the_sphere_and_reports_where_it_was(tmp_path: Path) -> None:
    height = 30.0
    async with disturbable(tmp_path, DRY_FEED=6000) as bench:
        with pytest.raises(Refused, match=r"dry_run_mm = 14: expected 0, or 15 to 1000 over the sphere"):
            await bench.nc.request_probing(1, LEAST_MM - 1.0)
        await bench.operator.ask("record", *SIGNALS)
        await bench.nc.request_probing(2, height)

        async def over() -> bool:
            return (await bench.nc.probing_status(2)).state in FINAL

        await until(over)
        done = await bench.nc.probing_status(2)
        rows = np.array(await bench.operator.ask("recorded"))
    assert done.state is ProbingState.DONE, done
    assert done.spread_mm == pytest.approx(0.0, abs=1e-6)
    nominal = [(120, 0, 80), (0, 120, 80), (-120, 0, 80), (0, -120, 80), (120, -80, 0), (120, 80, 0)]
    assert done.centres_mm is not None
    for found, (x, y, z) in zip(done.centres_mm, nominal, strict=True):
        assert found == pytest.approx((x, y, z + height), abs=1e-6)
    # Beside the raised sphere it was as near as a touch is, and to the sphere itself no nearer than the difference.
    on_path = rows[distances(rows) < 60.0]
    assert distances(on_path).min() > height - BALL_MM
    speeds = np.abs(np.diff(rows[:, :3], axis=0)).max() * 1e3 * 60.0
    assert speeds <= 6000.0 * 1.01, "reduced feed, mm/min"
