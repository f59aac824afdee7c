"""The report's first lines: figures by hand, what was lost, and what the probing cannot see."""

import re
from dataclasses import replace

import numpy as np
import pytest

from gateway.reporting.data import CycleSeen, ReportData
from gateway.reporting.figures import SummaryRow, summary
from gateway.reporting.first_lines import losses, verdict
from talc.frame import Phase
from tests.benches.small_run import STEP_S, small_run, with_gap


def told(data: ReportData) -> str:
    return verdict(data, summary(data))


def productive(data: ReportData) -> float:
    """%: the last number of the verdict."""
    return float(re.findall(r"-?[\d.]+", told(data))[-1])


def lost(data: ReportData) -> dict[str, str]:
    return dict(losses(data, summary(data)))


def test_the_first_line_is_the_worst_axis_and_what_it_cost() -> None:
    """12 cycles of 2 min in 4 h: a tenth of the time."""
    assert re.findall(r"[\d.]+|\b[XYZ]\b", told(small_run())) == ["Z", "40", "4.0", "90", "90"]


def test_the_first_hour_and_the_rest_have_figures_of_their_own() -> None:
    """In the first hour nothing of EZ0A's 40 µm is predicted, afterwards all but a tenth."""
    run = small_run()
    predicted = run.predicted.copy()
    predicted[:12] = 0.0
    found = summary(replace(run, predicted=predicted))
    for row in (next(row for row in found.rows if row.name == "EZ0A"), found.tool[2]):
        first, later = row.parts
        figures = [first.e_rms, first.compensated_e_rms, first.e_pv, first.compensated_e_pv]
        assert figures == pytest.approx([40.0, 40.0, 80.0, 80.0])
        figures = [later.e_rms, later.compensated_e_rms, later.e_pv, later.compensated_e_pv]
        assert figures == pytest.approx([40.0, 4.0, 80.0, 8.0])
        assert row.compensated_e_pv == pytest.approx(80.0)
    assert not summary(small_run(13)).rows[1].parts, "after the first hour there is one value: no peak to peak"


def test_the_tool_sees_an_error_at_a_radius_through_its_lever() -> None:
    run = small_run()
    tilted = np.zeros_like(run.measured)
    tilted[:, 7] = 100.0  # EB0C, µm/m: 12 µm along Z at 120 mm, 8 µm along X at 80 mm
    rows = summary(replace(run, measured=tilted, predicted=tilted)).tool
    assert [round(row.e_rms, 6) for row in rows] == [8.0, 0.0, 12.0]


def test_refused_cycles_cost_time_as_well_and_are_reported() -> None:
    run = small_run()
    refused = tuple(CycleSeen(STEP_S * i, "a touch repeats by 14 µm") for i in range(6))
    more = replace(run, cycles_seen=run.cycles_seen + refused)
    assert productive(more) == 85.0
    assert lost(more)["refused"].startswith("6")
    assert lost(more)["refused"].endswith("a touch repeats by 14 µm")


def test_a_run_that_has_only_just_begun_is_not_less_than_unproductive() -> None:
    reference = (CycleSeen(300.0, "", 5),)
    assert productive(replace(small_run(1), cycles_seen=reference)) == 0.0
    assert productive(replace(small_run(4), cycles_seen=reference)) == 50.0


def test_gaps_and_stale_periods_are_reported() -> None:
    gap = with_gap(small_run(), 11, 24)
    assert lost(gap)["gaps"] == "1, 2.0 h without a step; the longest 2.0 h, Mon 2026-01-05 07:55 CET"
    stale = np.zeros(48, dtype=np.bool_)
    stale[[3, 4, 20]] = True
    said = lost(replace(small_run(), stale=stale))
    assert said["stale"] == "15 min in 2 periods without a usable prediction"
    assert "gaps" not in lost(small_run())


def test_what_got_worse_is_a_loss_too() -> None:
    run = small_run()
    predicted = run.predicted.copy()
    predicted[:, 2] = 3.0  # EX0C is zero
    said = lost(replace(run, predicted=predicted))
    assert said["worse"] == "tool X 0.0 → 3.0 µm, EX0C 0.0 → 3.0 µm"


def test_for_a_recording_it_says_where_holding_the_last_measurement_would_have_left_less() -> None:
    run = small_run()  # EZ0A: 40 µm, of which 4 are left
    for held, said in (
        (0.95, {"beaten": "EZ0A 4.0 instead of 2.0 µm"}),
        (0.8, {}),
    ):
        recorded = replace(run, recorded=run.measured, held=held * run.measured, cycles_seen=())
        assert lost(recorded) == said


def test_a_gateway_that_writes_nothing_says_so() -> None:
    assert "'monitor'" in lost(replace(small_run(), mode="monitor"))["unwritten"]
    assert "unwritten" not in lost(small_run())


@pytest.mark.parametrize(
    ("before", "after", "noise", "kind", "by"),
    [
        (40.0, 3.6, 1.0, "percent_less", 91.0),
        (0.05, 0.9, 1.0, "noise", None),  # 1700 % more of nothing
        (0.05, 1.54, float("nan"), "more", 1.49),  # -2980 %
        (0.9, 1.5, 1.0, "more", 0.6),  # it could not be seen before: a percentage of it says nothing
        (10.0, 12.0, 1.0, "percent_more", 20.0),
        (10.0, 0.5, 1.0, "percent_less", 95.0),
        (10.0, 10.02, 1.0, "unchanged", None),
        (0.0, 0.0, float("nan"), "unknown", None),
    ],
)
def test_a_change_is_a_percentage_where_that_says_something(
    before: float, after: float, noise: float, kind: str, by: float | None
) -> None:
    row = SummaryRow("EX0C", "µm", before, before, after, after, noise)
    for change in (row.change_rms, row.change_pv):
        assert change.kind == kind
        assert by is None or change.by == pytest.approx(by)


def test_nothing_is_promised_before_corrections_began() -> None:
    run = replace(small_run(), phases=(Phase.CALIBRATION,) * 48)
    found = summary(run)
    assert (found.basis, found.rows, found.tool) == ("nothing", (), ())
    assert re.findall(r"\d", verdict(run, found)) == []


def test_cycles_of_a_rehearsal_leave_no_less_than_nothing() -> None:
    """They are shorter than the two minutes that are counted for a cycle."""
    run = small_run()
    assert summary(run).productivity == pytest.approx(60.0, abs=2.0)
    assert summary(replace(run, step_s=10.0)).productivity == 0.0
