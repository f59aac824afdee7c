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
from tests.benches.printed_pages import printed
from tests.benches.small_run import small_run


@pytest.mark.peer
def test_a_run_is_printed_on_at_most_six_pages_with_its_figures_and_every_instrument(tmp_path: Path) -> None:
    many = tuple((f"{'sensor of the bed ' * 3}{i:02}", f"{'A1b-' * 14}{i:03}", "2025-11-03", "") for i in range(39))
    instruments = (*many, ("probe", "P-7", "2025-01-01", "2025-12-03"))
    health = {f"channel_{i}": {"good": 1, "timeout": 2} for i in range(200)}
    hashed = "5f" * 32
    full = replace(small_run(48), language="de", tolerance_um=8.0, instruments=instruments)
    paper = tmp_path / "report.pdf"
    write_paper(paper, replace(full, channel_health=health, source=hashed))
    pages = printed(paper, "-layout")
    assert len(pages) == 6
    for figure in ("→ 4,0 µm", "90 %", "100 %", "± 8 µm", "24 min", "probe"):  # probed 12 times, 2 min each
        assert figure in pages[0], figure
    assert [serial for _, serial, _, _ in instruments if serial not in pages[1]] == []
    assert hashed in pages[5]
    for page in printed(paper, "-bbox"):
        height = float(re.findall(r'<page .*height="([\d.]+)"', page)[0])
        *ends, foot = sorted({float(end) for end in re.findall(r'yMax="([\d.]+)"', page)})
        assert ends[-1] < foot - 5.0, "nothing is printed over the foot of the page"
        assert foot < height
        wide = float(re.findall(r'<page width="([\d.]+)"', page)[0])
        assert min(float(begin) for begin in re.findall(r'xMin="([\d.]+)"', page)) > 0.079 * wide, "in the margin"
    write_paper(paper, small_run(1))
    assert len(printed(paper, "-layout")) <= 6


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
    for figure in ("144 ", " 10 s ", "24 min", "10.0 %"):
        assert figure in dict(losses(found, summary(found)))["probing"]
    longer = replace(run, cycles_seen=tuple(replace(each, lasted_s=139.0) for each in cycles[:90]))
    assert " 139 s " in dict(losses(longer, summary(longer)))["probing"], "90 of 2 min are not 3.5 h"
    waited = replace(run, cycles_seen=(*cycles, CycleSeen(step_s, "the control is busy", lasted_s=900.0)))
    assert "24 min" in dict(losses(waited, summary(waited)))["probing"], (
        "a request that waited in vain is no cycle of 900 s"
    )
