"""Adaptive inputs: seasons one after the other, repetitions on the same physics, and the small version whole."""

from typing import Any

import numpy as np
import pytest

from simulators.studies import STUDIES, Run
from simulators.studies.adaptive_inputs import CALIBRATION, SMALL_STEPS, series
from simulators.studies.adaptive_inputs_report import PAPER_MEAN_E_PV, WAYS
from talc.names import THERMAL_ERRORS

STUDY = STUDIES["adaptive-inputs"]


@pytest.fixture(scope="module")
def small() -> list[Run]:
    return [Run(p, STUDY.run(p)) for p in STUDY.runs(1, True)]


def test_the_full_study_is_25_repetitions_of_three_selectors_static_and_adaptive() -> None:
    wanted = STUDY.runs(1, False)
    assert len(wanted) == 150
    assert {(p["selector"], p["inputs"]) for p in wanted} == set(WAYS)


def test_a_repetition_is_other_noise_on_the_same_days(small: list[Run]) -> None:
    one, two = series(1, 0, True), series(1, 1, True)
    assert np.array_equal(one.truth, two.truth)
    assert not np.array_equal(one.measured, two.measured)
    apart = one.inputs[:, :29] - two.inputs[:, :29]
    assert 0.03 < apart.std() < 0.12  # two draws of 0.05 K in steps of 0.1 K
    before = small[0].result["none"]["E_PV"]
    assert before == pytest.approx(np.ptp(one.truth[CALIBRATION + 1 :], axis=0).tolist())


def test_static_inputs_stay_and_adaptive_ones_are_chosen_again(small: list[Run]) -> None:
    by_inputs = {run.parameters["inputs"]: run.result for run in small}
    for result in by_inputs.values():
        assert result["inputs"][0]["after"] <= CALIBRATION
        assert len(result["inputs"]) == len(result["updates"]) + 1 >= 2
    first, *later = ({e: set(m.get(e, ())) for e in THERMAL_ERRORS} for m in by_inputs["static"]["inputs"])
    assert all(models[e] <= first[e] for models in later for e in THERMAL_ERRORS)
    first, *later = ({e: set(m.get(e, ())) for e in THERMAL_ERRORS} for m in by_inputs["adaptive"]["inputs"])
    assert any(models[e] - first[e] for models in later for e in THERMAL_ERRORS)


def test_models_leave_less_than_nothing_and_than_the_held_measurement(small: list[Run]) -> None:
    for run in small:
        left, hold, none = (np.mean(run.result[what]["E_RMS"][:6]) for what in ("models", "hold", "none"))
        assert left < 0.5 * hold < 0.5 * none


def test_the_report_marks_the_papers_figures_and_draws_what_it_has(small: list[Run]) -> None:
    report = STUDY.report(small)
    rows = {row.cells[0]: row.cells for row in report.summary.rows}
    assert set(rows) == {"none", "hold", "regression", "search, static", "search, adaptive"}
    table: Any = report.sections[0].blocks[0]
    assert {row.cells[-1] for row in table.rows if row.paper} >= {f"{v:g}" for v in PAPER_MEAN_E_PV.values()}
    course: Any = report.sections[-1].blocks[0]
    assert course.svg.startswith("<svg")
    drawn = next(run.result["drawn"] for run in small if run.parameters["inputs"] == "adaptive")
    assert len(drawn["left"][0]) == SMALL_STEPS / 3
    assert drawn["left"][0][0] is None
