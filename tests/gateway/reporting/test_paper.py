"""The report on paper: its pages, and how often later measurements confirm its intervals and the tolerance."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gateway.reporting.coverage import covered, within_tolerance
from gateway.reporting.data import CycleSeen
from gateway.reporting.figures import summary
from gateway.reporting.first_lines import losses, verdict
from gateway.reporting.paper import write_paper
from tests.benches.small_run import small_run


def test_a_run_is_printed_on_at_most_six_pages(tmp_path: Path) -> None:
    many = tuple((f"sensor {i}", f"SN {i}", "2025-11-03", "2025-12-03") for i in range(40))
    health = {f"channel_{i}": {"good": 1, "timeout": 2} for i in range(200)}
    full = replace(small_run(48), language="de", tolerance_um=8.0, instruments=many, channel_health=health)
    for data in (full, small_run(1)):
        write_paper(tmp_path / "report.pdf", data)
        found = (tmp_path / "report.pdf").read_bytes()
        assert found.startswith(b"%PDF-")
        assert 1 <= len(re.findall(rb"/Type /Page\b", found)) <= 6


def test_the_intervals_are_counted_against_the_measurements_that_came_after_them() -> None:
    run = small_run(48)
    zero = np.zeros_like(run.predicted)
    measured = np.full_like(run.measured, np.nan)
    measured[[10, 20, 30, 40], 1] = (0.0, 1.9, -2.1, 50.0)
    data = replace(
        run,
        predicted=zero,
        sigma=np.ones_like(zero),
        noise=np.zeros(9),
        measured=measured,
        trusted=np.ones(zero.shape, bool),
    )
    error = covered(data)[1]
    assert (error.compared, error.inside) == (4, 2)
    assert error.half == pytest.approx(1.96, abs=0.01)
    assert covered(data)[0].compared == 0
    k = data.k.copy()
    k[20:] += 5  # the gateway was off before that step
    doubted = np.ones(zero.shape, bool)
    doubted[39, 1] = False  # nothing was corrected
    error = covered(replace(data, k=k, trusted=doubted))[1]
    assert (error.compared, error.inside) == (2, 1)


def test_the_tolerance_is_judged_in_all_axes_since_corrections_began() -> None:
    run = small_run(48)
    assert within_tolerance(run, summary(run)) is None
    loose, tight = (within_tolerance(replace(run, tolerance_um=um), summary(run)) for um in (1e4, 1e-4))
    assert loose == (1.0, 1.0)
    assert tight is not None
    assert max(tight) < 1.0


def test_cycles_take_the_time_that_was_measured() -> None:
    """144 cycles of 10 s in 48 steps of five minutes are a tenth of the time, not all of it."""
    run = small_run(48)
    step_s = float(run.step_s)
    cycles = tuple(CycleSeen(step_s * i / 3, "", lasted_s=10.0) for i in range(144))
    found = replace(run, cycles_seen=cycles)
    assert verdict(found, summary(found)).endswith("90 % productive")
    assert dict(losses(found, summary(found)))["probing"] == "144 cycles of 10 s, 24 min, 10.0 % of the time"
    waited = replace(run, cycles_seen=(*cycles, CycleSeen(step_s, "the control is busy", lasted_s=900.0)))
    assert "24 min" in dict(losses(waited, summary(waited)))["probing"], (
        "a request that waited in vain is no cycle of 900 s"
    )
