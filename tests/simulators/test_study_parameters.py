"""The parameter study: its figures from their definitions, its choice of the best set, and the small version whole."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from simulators.studies import STUDIES, Run
from simulators.studies.parameters import CALIBRATION_H, INTERVAL_H, NO_GOOD, judged, series
from simulators.studies.parameters_report import PAPER

STUDY = STUDIES["parameters"]
SMALL, LONGER = STUDY.runs(1, True)


@pytest.fixture(scope="module")
def small() -> Mapping[str, Any]:
    return STUDY.run(SMALL)


def test_the_full_study_is_every_combination_on_four_load_cases() -> None:
    assert len(INTERVAL_H) * len(NO_GOOD) * len(CALIBRATION_H) == 2197
    wanted = STUDY.runs(1, False)
    assert len(wanted) == 4 * len(CALIBRATION_H)
    assert {p["case"] for p in wanted} == set(PAPER)


def test_figures_from_their_definitions() -> None:
    truth = np.zeros((600, 9))
    truth[:, 0] = np.arange(600)
    estimate = truth.copy()
    estimate[100:, 6:] += 50.0  # µm/m: not among the position errors
    used = np.zeros(600, dtype=np.bool_)
    used[:30] = True
    figures = judged(truth, estimate, used, 4.0)
    assert figures["P99"] == 0.0
    assert figures["Pd"] == pytest.approx(100.0 * (1.0 - 30 * 95.0 / (600 * 600.0)))
    estimate[25:, 1] = 3.0  # one of six everywhere after the calibration of 24 steps: sqrt(9 / 6)
    figures = judged(truth, estimate, used, 4.0)
    assert figures["P99"] == 3.0
    assert figures["RMSE"] == pytest.approx(np.sqrt(1.5))
    assert figures["measurements"] == 30


def test_no_compensation_is_the_machine_itself(small: Mapping[str, Any]) -> None:
    truth = series("A", 1).truth[40:, :6]
    assert small["none"]["P99"] == pytest.approx(np.percentile(np.abs(truth), 99))


def test_fewer_measurements_leave_more(small: Mapping[str, Any]) -> None:
    short, long = ([p for p in small["fixed"] if p["interval_h"] == h] for h in (2.0, 8.0))
    assert np.mean([p["RMSE"] for p in short]) < np.mean([p["RMSE"] for p in long])
    for point in small["fixed"]:
        assert point["P99"] < 0.6 * small["none"]["P99"]
        assert point["P99"] < point["hold P99"]
        assert point["measurements"] >= 39 + 96 / point["interval_h"] * 0.7
    (policy,) = small["adaptive"]
    assert 39 <= policy["measurements"] < 576


def test_a_sparse_calibration_takes_half_the_measurements_and_its_models_compensate() -> None:
    result = STUDY.run(LONGER)
    dense = next(p for p in result["fixed"] if p["interval_h"] == 8.0)
    for kind in ("sparse_fixed", "sparse_adaptive"):
        (point,) = result[kind]
        assert point["policy"].endswith("calibrated each 20 min")
        assert point["P99"] < 0.6 * result["none"]["P99"]
        assert point["P99"] < point["hold P99"]
    (fixed,) = result["sparse_fixed"]  # measured each 4 h afterwards; without an update so often:
    assert 24 + (96 - 8) / 4 * 0.9 <= fixed["measurements"] < dense["measurements"]


def test_the_report_finds_the_best_set_below_five(small: Mapping[str, Any]) -> None:
    points = [dict(small["fixed"][0]) for _ in range(4)]
    for point, p99, pd, interval in zip(
        points, (4.9, 4.0, 5.1, 4.99), (95.0, 94.0, 99.0, 96.0), (1, 2, 3, 4), strict=True
    ):
        point |= {"P99": p99, "Pd": pd, "interval_h": interval, "no_good": 12, "measurements": round(1000 * (100 - pd))}
    policy = {**small["adaptive"][0], "P99": 4.0, "measurements": 2000}
    sparse = {**policy, "policy": "each 30 min", "measurements": 1600}
    result = {**small, "fixed": points, "adaptive": [policy], "sparse_adaptive": [sparse]}
    report = STUDY.report([Run(SMALL, result)])
    rows = {row.cells[0]: row for row in report.summary.rows}
    assert rows["best common set here: 6.5 h, then 4 h, no good 12 × 10 min"].cells[1] == "4.99 / 96.00"
    assert rows["paper: its best common set"].paper
    fewest = "fewest measurements for P99 ≤ 5 µm: "
    assert rows[fewest + "fixed interval"].cells[1] == "4000"
    assert rows[fewest + "policy"].cells[1] == "2000"
    assert rows[fewest + "policy, sparse calibration"].cells[1] == "1600"
    assert rows[fewest + "fixed interval, sparse calibration"].cells[1] == "–"
    assert [claim.holds for claim in report.claims][-3:] == [True, False, True]
    assert len(report.figures) == 1 + 6
