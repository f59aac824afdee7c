"""The parameter study: its figures from their definitions, its choice of the best set, and the whole small version."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from studies import STUDIES, Run
from studies.loop import fitted_in_hindsight, regressed
from studies.parameters import CALIBRATION_H, INTERVAL_H, NO_GOOD, case_days, figures_of
from studies.parameters_pictures import PAPER
from tests.benches.small_study import Studied, study_by_command

pytestmark = pytest.mark.slow

STUDY = STUDIES["parameters"]
SMALL, LONGER, REGRESSION, LEARNER = STUDY.runs(1, True)


@pytest.fixture(scope="module")
def studied(tmp_path_factory: pytest.TempPathFactory) -> Studied:
    return study_by_command(STUDY.name, tmp_path_factory.mktemp("study"))


def result_of(studied: Studied, parameters: Mapping[str, Any]) -> Mapping[str, Any]:
    return next(run.result for run in studied.runs if run.parameters == parameters)


@pytest.fixture(scope="module")
def small(studied: Studied) -> Mapping[str, Any]:
    return result_of(studied, SMALL)


def test_the_full_study_is_every_combination_on_four_load_cases() -> None:
    assert len(INTERVAL_H) * len(NO_GOOD) * len(CALIBRATION_H) == 2197
    wanted = STUDY.runs(1, False)
    assert len(wanted) == 4 * len(CALIBRATION_H) + 4 + 4
    assert {p["case"] for p in wanted} == set(PAPER)


def test_figures_from_their_definitions() -> None:
    truth = np.zeros((600, 9))
    truth[:, 0] = np.arange(600)
    estimate = truth.copy()
    estimate[100:, 6:] += 50.0  # µm/m: not among the position errors
    used = np.zeros(600, dtype=np.bool_)
    used[:30] = True
    figures = figures_of(truth, estimate, used, 4.0)
    assert figures["P99"] == 0.0
    assert figures["Pd"] == pytest.approx(100.0 * (1.0 - 30 * 95.0 / (600 * 600.0)))
    estimate[25:, 1] = 3.0  # one of six everywhere after the calibration of 24 steps: sqrt(9 / 6)
    figures = figures_of(truth, estimate, used, 4.0)
    assert figures["P99"] == 3.0
    assert figures["RMSE"] == pytest.approx(np.sqrt(1.5))
    assert figures["measurements"] == 30


def test_no_compensation_is_the_machine_itself(small: Mapping[str, Any]) -> None:
    truth = case_days("A", 1).truth[40:, :6]
    assert small["none"]["P99"] == pytest.approx(np.percentile(np.abs(truth), 99, method="hazen"))


def test_fewer_measurements_leave_more(small: Mapping[str, Any]) -> None:
    short, long = ([p for p in small["fixed"] if p["interval_h"] == h] for h in (2.0, 8.0))
    assert np.mean([p["RMSE"] for p in short]) < np.mean([p["RMSE"] for p in long])
    for point in small["fixed"]:
        assert point["P99"] < 0.6 * small["none"]["P99"]
        assert point["P99"] < point["hold P99"]
        assert point["measurements"] >= 39 + 96 / point["interval_h"] * 0.7
    (policy,) = small["adaptive"]
    assert 39 <= policy["measurements"] < 576


def test_a_sparse_calibration_takes_half_the_measurements_and_its_models_compensate(studied: Studied) -> None:
    result = result_of(studied, LONGER)
    dense = next(p for p in result["fixed"] if p["interval_h"] == 8.0)
    for kind in ("sparse_fixed", "sparse_adaptive"):
        (point,) = result[kind]
        assert point["policy"].endswith("calibrated each 20 min")
        assert point["P99"] < 0.6 * result["none"]["P99"]
        assert point["P99"] < point["hold P99"]
    (fixed,) = result["sparse_fixed"]  # measured each 4 h afterwards; without an update this often:
    assert 24 + (96 - 8) / 4 * 0.9 <= fixed["measurements"] < dense["measurements"]


def test_the_regression_is_measured_at_its_interval_and_no_more(studied: Studied) -> None:
    result = result_of(studied, REGRESSION)
    dense = {(p["calibration_h"], p["policy"]): p for p in result["regression"]}
    assert len(dense) == 2 * len(INTERVAL_H)
    here, used = case_days("A", 1), np.zeros(576, dtype=np.bool_)
    used[:40] = True  # 6.5 h each 10 min, both ends
    used[39 + 12 :: 12] = True
    point = dense[6.5, "regression each 2 h"]
    assert point["measurements"] == used.sum()
    assert point["P99"] == pytest.approx(figures_of(here.truth, regressed(here, used), used, 6.5)["P99"])
    assert {p["policy"].split(", ")[1] for p in result["sparse_regression"]} == {"calibrated each 20 min"}
    # After 8 h each 20 min: 25 measurements.
    assert min(p["measurements"] for p in result["sparse_regression"]) == 25 + (575 - 48) // 48


def test_the_learner_is_measured_hourly_at_first_and_then_as_its_way_says(studied: Studied) -> None:
    points = {p["policy"]: p for p in result_of(studied, LEARNER)["learner"]}
    # 12 h each hour, both ends; then each hour to the end of 96 h, the last one at 95 h.
    assert points["learner each 1 h"]["measurements"] == 13 + 83
    asked = points["learner within 5 µm"]
    assert 13 < asked["measurements"] < 96
    none = result_of(studied, SMALL)["none"]["P99"]
    assert all(p["P99"] < 0.5 * none for p in points.values())


def test_the_report_judges_the_learner_by_one_set_for_all_load_cases(small: Mapping[str, Any]) -> None:
    at = {"calibration_h": 12.0, "Pd": 99.0, "RMSE": 1.0, "SMAPE": 1.0}
    ways = (("each 2 h", 60, 1.0), ("each 4 h", 44, 2.2), ("within 5 µm", 30, 2.9))
    points = [{**at, "policy": f"learner {way}", "measurements": n, "P99": p99} for way, n, p99 in ways]
    plain = {"regression": [], "sparse_regression": [], "hindsight": {"P99": 1.0}}
    report = STUDY.report([Run(SMALL, small), Run(REGRESSION, plain), Run(LEARNER, {"learner": points})])
    claims = [claim for claim in report.claims if "the learner leaves a P99 of at most" in claim.text]
    assert [claim.holds for claim in claims] == [True, False]
    assert "2.20 (A) at 12 h, then learner each 4 h" in claims[0].here
    assert "2.90 (A)" in claims[1].here


def test_gains_renewed_in_the_calibration_only_are_those_of_the_calibration_at_another_level() -> None:
    here, used = case_days("A", 1), np.zeros(576, dtype=np.bool_)
    used[:40], used[63::24] = True, True
    kept = regressed(here, used, np.arange(576) < 40)
    alone = regressed(here, used & (np.arange(576) < 40))
    assert kept[64:88] - alone[64:88] == pytest.approx(np.tile(here.measured[63] - alone[63], (24, 1)))
    assert np.abs(kept[64:88] - regressed(here, used)[64:88]).max() > 0.5


def test_the_fit_in_hindsight_leaves_less_than_the_one_that_had_to_wait(studied: Studied) -> None:
    result = result_of(studied, REGRESSION)
    assert result["hindsight"]["P99"] < min(p["P99"] for p in result["regression"])
    here = case_days("A", 1)
    rows = np.ones(576, dtype=np.bool_)
    assert np.abs(here.truth - fitted_in_hindsight(here, rows)).mean() < 0.1 * np.abs(here.truth).mean()


def test_chosen_sets_are_run_again_on_another_seed_and_another_machine(studied: Studied) -> None:
    again = [run for run in studied.runs if "sets" in run.parameters]
    assert {(run.parameters["seed"], run.parameters["machine"]) for run in again} == {
        (1, "base"),
        (2, "base"),
        (1, "warm"),
    }
    at = {(run.parameters["seed"], run.parameters["machine"]): run.result for run in again}
    first = {p["set"]: p for p in at[1, "base"]["sets"]}
    set_of_the_paper = "6.5 h, then 2 h, no good 12 × 10 min"
    grid = next(p for p in result_of(studied, SMALL)["fixed"] if p["interval_h"] == 2.0 and p["no_good"] == 12)
    for name in ("P99", "measurements", "hold P99", "regression P99"):
        assert first[set_of_the_paper][name] == pytest.approx(grid[name])
    warm = case_days("A", 1, "warm").truth[25:, :6]
    assert at[1, "warm"]["none"]["P99"] == pytest.approx(np.percentile(np.abs(warm), 99, method="hazen"))
    assert at[2, "base"]["none"]["P99"] != pytest.approx(at[1, "base"]["none"]["P99"])


def test_the_report_finds_the_best_set_below_five(small: Mapping[str, Any]) -> None:
    points = [dict(small["fixed"][0]) for _ in range(4)]
    for point, p99, pd, interval in zip(
        points, (4.9, 4.0, 5.1, 4.99), (95.0, 94.0, 99.0, 96.0), (1, 2, 3, 4), strict=True
    ):
        point |= {"P99": p99, "Pd": pd, "interval_h": interval, "no_good": 12, "measurements": round(1000 * (100 - pd))}
    policy = {**small["adaptive"][0], "P99": 4.0, "measurements": 2000}
    sparse = {**policy, "policy": "each 30 min", "measurements": 1600}
    result = {**small, "fixed": points, "adaptive": [policy], "sparse_adaptive": [sparse]}
    plain = {"calibration_h": 6.5, "policy": "regression each 4 h", **{k: policy[k] for k in ("P99", "Pd")}}
    peer = {"regression": [{**plain, "measurements": 1500}], "sparse_regression": [], "hindsight": {"P99": 1.0}}
    report = STUDY.report([Run(SMALL, result), Run(REGRESSION, peer)])
    rows = {row.cells[0]: row for row in report.summary.rows}
    assert rows["best common fixed interval here: 6.5 h, then 4 h, no good 12 × 10 min"].cells[1] == "4.99 / 96.00"
    assert rows["paper: its best common set"].paper
    fewest = "fewest measurements for P99 ≤ 5 µm: "
    assert rows[fewest + "fixed interval"].cells[1] == "4000"
    assert rows[fewest + "policy"].cells[1] == "2000"
    assert rows[fewest + "policy, sparse calibration"].cells[1] == "1600"
    assert rows[fewest + "fixed interval, sparse calibration"].cells[1] == "–"
    assert rows[fewest + "regression"].cells[1] == "1500"
    # Ours against the regression; half of a fixed interval's, dense and sparse; half by sparse ones with policies.
    assert [claim.holds for claim in report.claims][-4:] == [False, True, False, True]
    assert len(report.figures) == 1 + 6 + 1
