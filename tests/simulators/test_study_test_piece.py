"""The test piece: geometry by hand, the workpiece's warming in closed form, and what the small study must show."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from simulators.plant import Recording
from simulators.studies import STUDIES, Run
from simulators.studies.loop import days, held, regressed
from simulators.studies.test_piece import SETS, STEP_S, TO_AIR_S, TO_TABLE_S, deviations, growth, workpiece

STUDY = STUDIES["test-piece"]


@pytest.fixture(scope="module")
def small() -> Mapping[str, Any]:
    (parameters,) = STUDY.runs(1, True)
    return STUDY.run(parameters)


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
    series = days(Recording(tuple(f"t{i}" for i in range(36)), inputs, truth), 5)
    used = np.zeros(80, dtype=np.bool_)
    used[:60:2] = True
    hold, plain = held(series, used), regressed(series, used)
    assert np.isnan(hold[0]).all()
    assert np.array_equal(hold[1:3], series.measured[[0, 0]])
    assert np.array_equal(hold[79], series.measured[58])
    assert np.isnan(plain[46]).all()
    assert np.isfinite(plain[47:]).all()
    assert np.abs(plain[59:, 0] - truth[59:, 0]).mean() < np.abs(hold[59:, 0] - truth[59:, 0]).mean()


def test_compensation_lessens_the_drift_and_the_growth_term_lessens_it_further(small: Mapping[str, Any]) -> None:
    ranges = {name: np.ptp(np.array(small[name]), axis=0).mean() for name in ("none", "TALC", "TALC + growth")}
    assert ranges["TALC"] < ranges["none"]
    assert ranges["TALC + growth"] < 0.5 * ranges["none"]
    assert np.array(small["none"]).shape == (SETS, 6)
    assert not np.array(small["TALC"])[0].any()


def test_the_report_has_every_feature_and_method(small: Mapping[str, Any]) -> None:
    (parameters,) = STUDY.runs(1, True)
    report = STUDY.report([Run(parameters, small)])
    assert [row.cells[0] for row in report.summary.rows] == ["none", "hold", "regression", "TALC"]
    assert len(report.figures) == 1 + 8 * SETS
    drift = np.ptp(np.array(small["none"]), axis=0).mean()
    assert float(report.summary.rows[0].cells[1]) == pytest.approx(drift, rel=5e-3)
