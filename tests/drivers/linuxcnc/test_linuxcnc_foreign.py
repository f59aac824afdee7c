"""Some of the disturbances of tests.benches.linuxcnc_foreign. Needs Debian's linuxcnc-uspace."""

import random
from pathlib import Path

import numpy as np
import pytest

from drivers.base import Refused
from drivers.nc import ProbingState, RequestStatus
from tests.benches.linuxcnc_bench import until
from tests.benches.linuxcnc_foreign import (
    BALL_MM,
    BLOCKS,
    DEEP_MM,
    FINAL,
    KINDS,
    LENGTH_MM,
    NO_CEILING_MM,
    SAFE_MM,
    SIGNALS,
    allow,
    beyond_ceiling_mm,
    distances,
    disturbable,
    disturbed,
    lower_ceiling,
)

pytestmark = [pytest.mark.peer, pytest.mark.slow, pytest.mark.waits(40)]

PROBING = 5
"""LinuxCNC's number of the motion type of G38.3."""
LEAST_MM = 15.0
"""BALL and twice REACH of the bench's machine."""
CODES = {
    **dict.fromkeys(("block", "G43.1 Z1", "mdi", "hand"), ("foreign",)),
    **{"mode": ("other_mode",), "limit": ("not_ready",), "may-start": ("may_start_ended",)},
    **{"contact": ("contact", "stopped"), "probe": ("probe_failed", "stopped"), "interpreter": ("interpreter",)},
    "jog": ("other_mode", "foreign"),
}
"""By the moment: LinuxCNC itself stops at a contact on the way up; and for the jog it leaves MDI, or before that the
program's kind of motion."""


async def test_a_cycle_that_was_not_alone_has_no_result_and_leaves_the_probe_safe(tmp_path: Path) -> None:
    draw = random.Random(7)
    async with disturbable(tmp_path) as bench:
        for number, kind in enumerate(CODES, start=1):
            assert kind in (*KINDS, *BLOCKS)
            one = await disturbed(bench, kind, number, draw)
            assert one.safe, one
            assert one.status.code in CODES[kind]


async def test_below_the_safe_height_every_way_up_stops_at_a_contact_within_the_declared_way(tmp_path: Path) -> None:
    async with disturbable(tmp_path) as bench:
        hal = bench.operator

        async def is_over() -> bool:
            return (await bench.nc.probing_status(1)).state in FINAL and await hal.sees(idle=True)

        assert await hal.number("gets", "z-drive") == pytest.approx(0.0, abs=1e-6)
        await lower_ceiling(bench)  # on the way up to SAFE_Z, before the first pose
        await hal.ask("record", *SIGNALS)
        await bench.nc.request_probing(1)
        await until(is_over)
        rows = np.array(await hal.ask("recorded"))
        first = await bench.nc.probing_status(1)
        await hal.ask("hal", "sets", "ceiling-at", str(NO_CEILING_MM))
        await hal.ask("mdi", "o<talc_retract> call")
        await hal.ask("mdi", "T0 M6")
        await allow(bench)
        # Up from beside the sphere, or over it, and then the retract.
        one = await disturbed(bench, "ceiling", 2, random.Random(3))
    assert (first.state, first.centres_mm) == (ProbingState.FAILED, None)
    assert 0.0 < beyond_ceiling_mm(rows) < DEEP_MM
    assert np.abs(rows[:, [0, 1, 3, 4]]).max() == 0.0, "nothing but Z has moved"
    assert one.safe, one


async def test_a_withdrawal_within_a_touch_ends_the_cycle_before_the_next_one(tmp_path: Path) -> None:
    slow_mm_per_s = 0.05
    async with disturbable(tmp_path, FEED=60.0 * slow_mm_per_s) as bench:
        hal = bench.operator

        async def touches() -> bool:
            """Slowly, in a straight probing move: the second touch of a side."""
            kind, speed = [await hal.number("getp", f"motion.{pin}") for pin in ("motion-type", "requested-vel")]
            return kind == PROBING and 0.0 < speed < 2.0 * slow_mm_per_s

        async def over() -> bool:
            return (await bench.nc.probing_status(1)).state in FINAL and await hal.sees(idle=True)

        await hal.ask("record", *SIGNALS, "talc-seconds")
        await bench.nc.request_probing(1)
        await until(touches)
        withdrawn_s = await bench.time_s()
        await bench.nc.withdraw_probing(1)
        assert await touches()
        await until(over)
        ended = await bench.nc.probing_status(1)
        rows = np.array(await hal.ask("recorded"))
        rows = rows[rows[:, -1] >= withdrawn_s]
    assert (ended.state, ended.code, ended.centres_mm) == (ProbingState.FAILED, "withdrawn", None)
    within = distances(rows) < BALL_MM
    assert (np.diff(within.astype(int)) == 1).sum() + int(within[0]) <= 1, "the touch that was under way, and no other"
    assert (BALL_MM - distances(rows)).max() < DEEP_MM
    assert rows[:, 2].max() - LENGTH_MM == pytest.approx(SAFE_MM, abs=1e-3), "up, before the tool is changed back"
    assert np.ptp(rows[:, 3:5], axis=0).max() == 0.0, "the table does not turn any more"


async def test_a_probe_that_says_that_it_does_not_work_is_not_taken_to_the_sphere(tmp_path: Path) -> None:
    async with disturbable(tmp_path) as bench:
        hal, at = bench.operator, (await bench.operator.ask("state"))["position"]

        async def ends(number: int) -> RequestStatus:
            async def over() -> bool:
                return (await bench.nc.probing_status(number)).state in FINAL and await hal.sees(idle=True)

            await bench.nc.request_probing(number)
            await until(over)
            return await bench.nc.probing_status(number)

        await hal.ask("hal", "sets", "probe-dead", "1")
        silent = await ends(1)
        await hal.ask("hal", "sets", "probe-dead", "0")
        hook = tmp_path / "machine" / "nc" / "talc_switch.ngc"
        before = hook.read_text()
        hook.write_text(
            before.replace("o<talc_switch> endsub", "#<_talc_reason> = 2\nM68 E9 Q[1 + #1]\no<talc_switch> endsub")
        )
        switched = await ends(2)
        assert await hal.number("getp", "motion.analog-out-09") == 1.0, "off again, at the end"
        assert (await hal.ask("state"))["position"] == pytest.approx(at, abs=1e-6)
        hook.write_text(before)
        assert (await ends(3)).state is ProbingState.DONE
    for found in silent, switched:
        assert found.state is ProbingState.REFUSED
        assert found.code == "probe_silent"


async def test_a_dry_run_goes_the_path_above_the_sphere_and_reports_where_it_was(tmp_path: Path) -> None:
    height = 30.0
    async with disturbable(tmp_path, DRY_FEED=12000) as bench:
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
    assert speeds <= 12000.0 * 1.01, "reduced feed, mm/min"
