"""The test piece: geometry by hand, the workpiece's warming in closed form, and what the small study must show."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, get_args

import numpy as np
import pytest

from simulators.cases import Axis
from simulators.plant import MACHINES, FailureKind, PlantRecording, load_machine
from studies import STUDIES, Run, days, held
from studies.loop import regressed
from studies.test_piece import (
    OTHER_REPETITIONS,
    REPETITIONS,
    SETS,
    STEP_S,
    TO_AIR_S,
    TO_TABLE_S,
    deviations,
    failures,
    growth,
    workpiece,
)
from tests.benches.small_study import Studied, study_by_command

pytestmark = pytest.mark.slow

STUDY = STUDIES["test-piece"]


@pytest.fixture(scope="module")
def studied(tmp_path_factory: pytest.TempPathFactory) -> Studied:
    return study_by_command(STUDY.name, tmp_path_factory.mktemp("study"))


@pytest.fixture(scope="module")
def small(studied: Studied) -> Mapping[str, Any]:
    """The small study's runs with whole sensors."""
    return next(run.result for run in studied.runs if not run.parameters["failing"])


def test_features_show_the_errors_that_geometry_says() -> None:
    """EZ0T lifts the top face; turned by -90° about X the table's Z lies along Y; radial growth moves the sides."""
    table_up = deviations(np.array([0, 0, 0, 0, 7.0, 0, 0, 0, 0]))
    assert table_up == pytest.approx([7, 0, 0, 0, 0, 7], abs=1e-4)
    grown = deviations(np.array([0, 0, 0, 0, 0, 20.0, 0, 0, 0]))  # at 200 mm
    assert grown[1:5] == pytest.approx([9, 9, 9, 9], abs=1e-3)
    assert deviations(np.array([3.0, 5.0, 0, 0, 0, 0, 0, 0, 0])) == pytest.approx([5, 0, 0, 3, 5, 3])


def test_growth_is_length_times_expansion() -> None:
    assert growth(2.0) == pytest.approx(23.1e-3 * 2.0 * np.array([80, 90, 90, 90, 90, 40]))


def test_the_workpiece_follows_a_step_of_the_table_as_its_time_constants_say() -> None:
    table = np.concatenate([np.full(1, 20.0), np.full(40, 26.0)])
    piece = workpiece(table, np.full(41, 20.0))
    rate = 1 / TO_TABLE_S + 1 / TO_AIR_S
    end = 20.0 + 6.0 * (1 / TO_TABLE_S) / rate
    at = 12 * STEP_S
    assert piece[12] == pytest.approx(end - (end - 20.0) * math.exp(-rate * at), rel=1e-12)


def test_peers_know_only_what_was_measured_before() -> None:
    draw = np.random.default_rng(3)
    inputs = 20.0 + draw.normal(size=(80, 36)).cumsum(axis=0)
    truth = inputs[:, :9] * 2.0 - 40.0
    series = days(PlantRecording(tuple(f"t{i}" for i in range(36)), inputs, truth), 5)
    used = np.zeros(80, dtype=np.bool_)
    used[:60:2] = True
    hold, plain = held(series, used), regressed(series, used)
    assert np.isnan(hold[0]).all()
    assert np.array_equal(hold[1:3], series.measured[[0, 0]])
    assert np.array_equal(hold[79], series.measured[58])
    assert np.isnan(plain[46]).all()
    assert np.isfinite(plain[47:]).all()
    assert np.abs(plain[59:, 0] - truth[59:, 0]).mean() < np.abs(hold[59:, 0] - truth[59:, 0]).mean()


def test_compensation_reduces_the_drift_and_the_growth_term_reduces_it_further(small: Mapping[str, Any]) -> None:
    ranges = {name: np.ptp(np.array(small[name]), axis=0).mean() for name in ("none", "TALC", "TALC + growth")}
    assert ranges["TALC"] < ranges["none"]
    assert ranges["TALC + growth"] < 0.5 * ranges["none"]
    assert np.array(small["none"]).shape == (SETS, 6)
    assert not np.array(small["TALC"])[0].any()


def test_the_learner_is_held_against_the_regression_place_by_place(small: Mapping[str, Any]) -> None:
    parameters = {"seed": 1, "machine": "base", "axis": "speed_c", "failing": False, "repetition": 0}
    for share, holds in ((1.04, True), (1.06, False)):
        learner = {f"learner{t}": (share * np.array(small[f"regression{t}"])).tolist() for t in ("", " + growth")}
        report = STUDY.report([Run(parameters, {**small, **learner})])
        claims = [claim for claim in report.claims if claim.text.startswith("The learner leaves no more")]
        assert [claim.holds for claim in claims] == [holds, holds]


def test_the_full_study_is_not_judged_on_one_machine_one_axis_and_whole_sensors() -> None:
    wanted = STUDY.runs(1, False)
    assert {p["machine"] for p in wanted} == set(MACHINES)
    assert {p["axis"] for p in wanted} == set(get_args(Axis))
    assert sum(p["failing"] for p in wanted) == OTHER_REPETITIONS
    assert sum((p["machine"], p["axis"], p["failing"]) == ("base", "speed_c", False) for p in wanted) == REPETITIONS


def test_three_sensors_fail_after_the_calibration_each_in_its_way() -> None:
    channels = load_machine().channels
    for seed in range(20):
        found = failures(channels, seed)
        assert len({f.channel for f in found} & set(channels)) == 3
        assert {f.kind for f in found} == set(FailureKind)
        assert all(36 * 3600.0 <= f.from_s <= 56 * 3600.0 for f in found)  # 12 h idle, 24 h calibration; 20 h follow


def test_an_input_that_reads_nothing_keeps_its_last_value_for_the_peers() -> None:
    draw = np.random.default_rng(4)
    inputs = 20.0 + draw.normal(size=(80, 36)).cumsum(axis=0)
    inputs[50:, 3], inputs[:2, 4] = np.nan, np.nan
    stuck = inputs.copy()
    stuck[50:, 3], stuck[:2, 4] = inputs[49, 3], inputs[2, 4]
    truth, used = stuck[:, :9] * 2.0, np.arange(80) % 2 == 0
    names = tuple(f"t{i}" for i in range(36))
    open_, plain = (
        regressed(replace(days(PlantRecording(names, i, truth), 5), inputs=i), used) for i in (inputs, stuck)
    )
    assert np.isfinite(open_[47:]).all()
    assert np.array_equal(open_[47:], plain[47:])


def test_a_failing_sensor_misleads_the_methods_and_not_the_machine(studied: Studied, small: Mapping[str, Any]) -> None:
    (other,) = (run.result for run in studied.runs if run.parameters["failing"])
    assert other["none"] == small["none"]
    assert other["workpiece_K"] == small["workpiece_K"]
    assert other["TALC"] != small["TALC"]
    assert other["regression"] != small["regression"]
    assert np.isfinite(np.array(other["TALC + growth"])).all()


def test_a_loss_against_the_regression_is_said_without_and_with_the_growth_term(small: Mapping[str, Any]) -> None:
    parameters = {"seed": 1, "machine": "base", "axis": "speed_c", "failing": False}
    for own, holds in ((0.5, True), (2.0, False)):
        result = dict(small)
        for term in ("", " + growth"):
            result[f"TALC{term}"] = (own * np.array(small[f"regression{term}"])).tolist()
            result[f"hold{term}"] = (3.0 * np.array(small[f"regression{term}"])).tolist()
        runs = [Run({**parameters, "repetition": r}, result) for r in range(3)]
        ours = [claim for claim in STUDY.report(runs).claims if claim.text.startswith("A learned model does better")]
        assert [claim.holds for claim in ours] == [holds, holds]
        assert all("regression" in claim.here for claim in ours)
