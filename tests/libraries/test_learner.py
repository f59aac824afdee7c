"""`talc.Learner`: any number of errors, NumPy and pandas, times with gaps; the same numbers as in the gateway."""

import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest

import talc
from talc.control import Controller
from talc.frame import Frame, Measurement
from talc.names import THERMAL_ERRORS
from talc.settings import LearnerSettings, TalcSettings
from tests.benches.thermal_series import ThermalSeries, series

EVERY = 9


@pytest.fixture(scope="module")
def days() -> ThermalSeries:
    """Days of a machine: six of its inputs, which explain three of its errors."""
    made = series(280, 3)
    return replace(made, names=made.names[:6], inputs=made.inputs[:, :6])


def sparse(days: ThermalSeries) -> np.ndarray:
    """(T, 9) the measurements of every ninth row."""
    return np.where((np.arange(len(days.truth)) % EVERY == 0)[:, None], days.measured, np.nan)


def test_it_predicts_what_the_gateway_would(days: ThermalSeries) -> None:
    controller = Controller(days.names, TalcSettings(learner=LearnerSettings(noise_um_per_m=1.0)))
    y, expected = sparse(days), []
    for k, row in enumerate(days.inputs):
        measured = Measurement(y[k], np.full(9, np.nan)) if np.isfinite(y[k]).any() else None
        expected.append(controller.step(Frame(k, row, np.isfinite(row), measured)))
    learner = talc.Learner().fit(days.inputs[:200], y[:200])
    before_the_next = -(-200 // EVERY) * EVERY
    mean, std = learner.predict(days.inputs[200:before_the_next], return_std=True)
    np.testing.assert_array_equal(mean, [d.predicted for d in expected[200:before_the_next]])
    np.testing.assert_array_equal(std, [d.sigma for d in expected[200:before_the_next]])


@pytest.mark.parametrize("many", [1, 2, 14])
def test_any_number_of_errors_is_learnt(days: ThermalSeries, many: int) -> None:
    columns = np.arange(many) % 3
    y, truth = sparse(days)[:, columns], days.truth[:, columns]
    learner = talc.Learner().fit(days.inputs[:200], y[:200])
    predicted = learner.predict(days.inputs[200:])
    assert predicted.shape == (80, many)
    alone = talc.Learner().fit(days.inputs[:200], y[:200, -1])
    np.testing.assert_array_equal(predicted[:, -1], alone.predict(days.inputs[200:]))
    left = truth[200:] - predicted
    assert (np.sqrt((left**2).mean(axis=0)) < 0.4 * np.sqrt((truth[200:] ** 2).mean(axis=0))).all()


def test_one_column_of_errors_is_predicted_as_one(days: ThermalSeries) -> None:
    learner = talc.Learner().fit(days.inputs[:100], days.measured[:100, 0])
    mean, std = learner.predict(days.inputs[100:110], return_std=True)
    assert mean.shape == std.shape == (10,)
    assert (std > 0).all()


def test_tables_give_the_same_numbers_and_keep_their_names(days: ThermalSeries) -> None:
    index = pd.date_range("2026-03-28 22:00", periods=280, freq="5min", tz="Europe/Zurich")  # summer time begins
    X = pd.DataFrame(days.inputs, columns=list(days.names), index=index)
    y = pd.DataFrame(sparse(days), columns=[f"drift {i}" for i in range(9)], index=index)
    plain = talc.Learner().fit(days.inputs[:200], sparse(days)[:200])
    learner = talc.Learner().fit(X[:200], y[:200])
    assert learner.error_names_[:2] == ("drift 0", "drift 1")
    assert list(learner.feature_names_in_) == list(days.names)
    assert learner.step_s_ == 300.0
    np.testing.assert_array_equal(learner.predict(X[200:]), plain.predict(days.inputs[200:]))
    series_y = talc.Learner().fit(X[:50], y["drift 3"][:50])
    assert series_y.error_names_ == ("drift 3",)


def test_a_gap_in_the_times_lets_the_lags_run_on(days: ThermalSeries) -> None:
    times = 300.0 * np.arange(280)
    kept = np.delete(np.arange(280), np.arange(150, 156))
    y = sparse(days)
    controller = Controller(days.names, TalcSettings(learner=LearnerSettings(noise_um_per_m=1.0)))
    for k in kept[:240].tolist():
        measured = Measurement(y[k], np.full(9, np.nan)) if np.isfinite(y[k]).any() else None
        last = controller.step(Frame(k, days.inputs[k], np.isfinite(days.inputs[k]), measured))
    learner = talc.Learner().fit(days.inputs[kept[:239]], y[kept[:239]], times[kept[:239]])
    row = kept[239:240]
    np.testing.assert_array_equal(learner.predict(days.inputs[row], times=times[row])[0], last.predicted)


@pytest.mark.parametrize("late_s", [0.0, 100.0, 160.0, 299.0])
def test_times_may_begin_anywhere_between_steps(days: ThermalSeries, late_s: float) -> None:
    times = 1.7e9 + late_s + 300.0 * np.arange(60)
    learner = talc.Learner().fit(days.inputs[:50], days.measured[:50], times[:50])
    plain = talc.Learner().fit(days.inputs[:50], days.measured[:50])
    np.testing.assert_array_equal(
        learner.predict(days.inputs[50:60], times=times[50:]), plain.predict(days.inputs[50:60])
    )


def test_rows_that_are_refused_leave_no_trace(days: ThermalSeries) -> None:
    times = 300.0 * np.arange(60)
    learner = talc.Learner().fit(days.inputs[:50], days.measured[:50], times[:50])
    with pytest.raises(ValueError, match="are in one step of 300 s"):
        learner.partial_fit(days.inputs[50:53], days.measured[50:53], [15_000.0, 15_300.0, 15_310.0])
    learner.partial_fit(days.inputs[50:60], days.measured[50:60], times[50:])
    whole = talc.Learner().fit(days.inputs[:60], days.measured[:60], times)
    later = times[-1] + np.array([300.0, 600.0, 900.0])
    np.testing.assert_array_equal(
        learner.predict(days.inputs[60:63], times=later),
        whole.predict(days.inputs[60:63], times=later),
    )


def test_learning_in_parts_is_learning_at_once_and_predictions_leave_no_trace(days: ThermalSeries) -> None:
    y = sparse(days)
    whole = talc.Learner().fit(days.inputs[:200], y[:200])
    parts = talc.Learner()
    for a, b in ((0, 1), (1, 90), (90, 200)):
        parts.partial_fit(days.inputs[a:b], y[a:b])
        parts.predict(days.inputs[b : b + 3])
    np.testing.assert_array_equal(parts.predict(days.inputs[200:]), whole.predict(days.inputs[200:]))
    np.testing.assert_array_equal(
        pickle.loads(pickle.dumps(parts)).predict(days.inputs[200:]), whole.predict(days.inputs[200:])
    )


def test_contributions_add_up_to_the_prediction(days: ThermalSeries) -> None:
    learner = talc.Learner().fit(days.inputs[:200], sparse(days)[:200])
    parts = learner.contributions(days.inputs[200:])
    assert parts.shape == (80, 9, 7)
    np.testing.assert_allclose(parts.sum(axis=2), learner.predict(days.inputs[200:]), atol=1e-9)


def test_the_unit_of_the_errors_only_scales(days: ThermalSeries) -> None:
    y = sparse(days)
    um = talc.Learner(noise=1.0).fit(days.inputs[:200], y[:200])
    mm = talc.Learner(unit_um=1000.0).fit(days.inputs[:200], y[:200] / 1000.0)
    for a, b in zip(
        um.predict(days.inputs[200:], return_std=True), mm.predict(days.inputs[200:], return_std=True), strict=True
    ):
        np.testing.assert_allclose(1000.0 * b, a, rtol=1e-6, atol=1e-6)


def test_a_noise_in_another_unit_than_the_errors_is_reported(
    days: ThermalSeries, recwarn: pytest.WarningsRecorder
) -> None:
    mm = sparse(days)[:200, :3] / 1000.0
    talc.Learner(unit_um=1000.0, noise=[0.001, 0.001, 100.0]).fit(days.inputs[:200], mm)
    assert not recwarn.list, "an error below the noise is not a matter of its unit"
    with pytest.warns(UserWarning, match=r"y is at most 0\.\d+, noise 1: too little .*; noise is in the unit of y"):
        talc.Learner(unit_um=1000.0, noise=1.0).fit(days.inputs[:200], mm)


def test_times_in_days_hours_or_minutes_are_not_taken_for_seconds(days: ThermalSeries) -> None:
    for unit_s in (86400.0, 3600.0, 60.0):
        times = 300.0 / unit_s * np.arange(200)
        with pytest.raises(ValueError, match=r"rows are [\d.]+ s apart if these numbers are seconds; .* give step_s"):
            talc.Learner().fit(days.inputs[:200], sparse(days)[:200], times)
    assert talc.Learner(step_s=0.05).fit(days.inputs[:200], sparse(days)[:200], 0.05 * np.arange(200)).step_s_ == 0.05
    dates = pd.date_range("2026-03-02", periods=200, freq="10s")  # dates say their unit themselves
    assert talc.Learner().fit(days.inputs[:200], sparse(days)[:200], dates).step_s_ == 10.0


def test_times_have_a_zone_at_fit_and_predict_or_at_neither(days: ThermalSeries) -> None:
    zoned = pd.date_range("2026-03-02", periods=280, freq="5min", tz="Europe/Zurich")
    plain, seconds = zoned.tz_localize(None), 300.0 * np.arange(280) + 1e10
    learner = talc.Learner().fit(days.inputs[:200], sparse(days)[:200], zoned[:200])
    for other in (plain, seconds, pd.Series(plain)):
        with pytest.raises(ValueError, match=r"fitted to dates with a time zone; these times are .*tz_localize"):
            learner.predict(days.inputs[200:], times=other[200:])
    expected = learner.predict(days.inputs[200:], times=zoned[200:])
    for same in (zoned.tz_convert("UTC"), pd.Series(zoned), zoned.to_pydatetime()):
        np.testing.assert_array_equal(learner.predict(days.inputs[200:], times=same[200:]), expected)


def test_missing_inputs_are_filled_and_make_it_less_sure(days: ThermalSeries) -> None:
    learner = talc.Learner().fit(days.inputs[:200], sparse(days)[:200])
    holes = days.inputs[200:].copy()
    holes[5:, :3] = np.nan
    _, sure = learner.predict(days.inputs[200:], return_std=True)
    mean, unsure = learner.predict(holes, return_std=True)
    assert np.isfinite(mean).all()
    assert (unsure[5] > sure[5]).all()


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"X": np.ones((5, 2)), "y": np.ones(4)}, "X has 5 rows, y 4: expected the same number"),
        ({"X": np.ones((3, 1)), "y": np.ones(3), "times": [0, 300, 300]}, "times: row 2 is not later than the row"),
        ({"X": np.ones((3, 1)), "y": np.ones(3), "times": [0, 1]}, r"times has shape \(2,\): expected \(3,\)"),
        ({"X": np.ones((4, 1)), "y": np.ones(4), "times": [0, 300, 301, 600]}, "rows 1 and 2 are in one step of 300 s"),
        ({"X": np.ones((3, 1)), "y": [1.0, 2e6, 3.0]}, "y: row 1 of y0 is 2e.06: expected at most a metre"),
        ({"X": [[1.0], [np.inf]], "y": np.ones(2)}, "X contains infinity, row 1, column 0; a missing value is NaN"),
        ({"X": np.ones((3, 1)), "y": np.full(3, np.nan)}, "y holds no measurement"),
    ],
)
def test_what_is_wrong_is_said(arguments: dict[str, object], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        talc.Learner(step_s=300.0).fit(**arguments)


@pytest.mark.parametrize("kind", [talc.Learner, talc.SparseOutputError])
def test_rows_of_other_times_are_not_put_side_by_side(kind: type[talc.Learner | talc.SparseOutputError]) -> None:
    index = pd.date_range("2026-03-02 06:00", periods=30, freq="5min")
    X, y = pd.DataFrame({"a": np.arange(30.0)}, index), pd.Series(np.arange(30.0), index)
    late = y.set_axis(index + pd.Timedelta(minutes=5))
    said = "row 0 is of 2026-03-02 06:00:00 in X and of 2026-03-02 06:05:00 in y; y.reindex"
    with pytest.raises(ValueError, match=said):
        kind().fit(X, late)
    with pytest.raises(ValueError, match=r"row 0 is of .*00:00 in y"):
        kind().fit(X, y.tz_localize("UTC"))
    kind().fit(X, y)


def test_noise_is_one_value_or_one_for_each_error() -> None:
    X, y = np.ones((3, 1)), np.ones((3, 2))
    assert talc.Learner(noise=[0.5, 2.0]).fit(X, y).error_names_ == ("y0", "y1")
    X, y = pd.DataFrame(X), pd.DataFrame(y, columns=["EX0C", "EZ0A"])
    x = X.iloc[-1:]
    by_name, by_place = (
        talc.Learner(noise=n).fit(X, y).predict(x, return_std=True) for n in ({"EZ0A": 0.5}, [1.0, 0.5])
    )
    np.testing.assert_array_equal(by_name, by_place)
    with pytest.raises(ValueError, match="noise names 'EZOA': y has EX0C, EZ0A"):
        talc.Learner(noise={"EZOA": 0.5}).fit(X, y)
    with pytest.raises(ValueError, match="noise has 3 values: expected one, or one for each of the 2 columns of y"):
        talc.Learner(noise=[0.5, 2.0, 1.0]).fit(X, y)


def test_a_column_of_text_is_named() -> None:
    X = pd.DataFrame({"a": [1.0, 2.0], "tool": ["T1", "T2"]})
    with pytest.raises(ValueError, match="X, column 'tool': could not convert string to float: 'T1'"):
        talc.Learner().fit(X, [1.0, 2.0])


def test_a_column_of_dates_is_named() -> None:
    for zone in (None, "Europe/Zurich"):
        X = pd.DataFrame({"a": [1.0, 2.0], "when": pd.date_range("2026-03-02", periods=2, tz=zone)})
        with pytest.raises(TypeError, match="X, column 'when' holds dates: expected numbers; give them as times"):
            talc.Learner().fit(X, [1.0, 2.0])


def test_what_is_missing_in_nullable_columns_is_missing() -> None:
    X = pd.DataFrame({"a": np.arange(40.0), "b": np.sin(np.arange(40.0))})
    y = pd.Series(3.0 * X["a"])
    X.loc[5, "a"] = y[1::4] = np.nan
    with_na, of_na = X.convert_dtypes(), y.convert_dtypes()
    assert with_na.loc[5, "a"] is of_na[1] is pd.NA
    plain, nullable = talc.Learner().fit(X[:30], y[:30]), talc.Learner().fit(with_na[:30], of_na[:30])
    np.testing.assert_array_equal(nullable.predict(with_na[30:]), plain.predict(X[30:]))
    with pytest.raises(ValueError, match="X, column 'tool': could not convert string to float: 'T1'"):
        talc.Learner().fit(with_na.assign(tool="T1"), of_na)


def test_an_error_s_name_occurs_once() -> None:
    y = pd.DataFrame([[1.0, 2.0], [3.0, 4.0]], columns=["lift", "lift"])
    for estimator in (talc.Learner(), talc.SparseOutputError()):
        with pytest.raises(ValueError, match="y: column 'lift' occurs twice"):
            estimator.fit([[1.0], [2.0]], y)


def test_an_hour_that_repeats_is_distinguished_from_rows_in_disorder() -> None:
    index = pd.date_range("2026-10-24 22:00", periods=100, freq="5min", tz="Europe/Zurich")
    X, y = np.arange(100.0)[:, None], np.arange(100.0)
    with pytest.raises(ValueError, match=r"row 60 is not later .* if summer time ended there, tz_localize\(zone, amb"):
        talc.Learner().fit(X, y, index.tz_localize(None))
    with pytest.raises(ValueError, match=r"row 1 is not later than the row before it; sort the rows by time$"):
        talc.Learner().fit(X, y, np.r_[4000.0, np.arange(99.0)])
    told_apart = index.tz_localize(None).tz_localize("Europe/Zurich", ambiguous="infer")
    assert talc.Learner().fit(X, y, told_apart).step_s_ == 300.0


@pytest.mark.parametrize(
    ("arguments", "X", "y", "error", "text"),
    [
        ({"noise": "small"}, [[1.0]], [1.0], TypeError, "noise = 'small': expected a number, or one for each column"),
        ({"step_s": "5min"}, [[1.0]], [1.0], TypeError, "step_s = '5min': expected a number"),
        ({"unit_um": None}, [[1.0]], [1.0], TypeError, "unit_um = None: expected a number"),
        ({}, [[]], [], ValueError, "y has no rows"),
    ],
)
def test_what_is_not_a_number_or_a_row_is_named(
    arguments: dict[str, Any], X: list[list[float]], y: list[float], error: type[Exception], text: str
) -> None:
    with pytest.raises(error, match=text):
        talc.Learner(**arguments).fit(X, y)


def test_rows_to_predict_must_follow(days: ThermalSeries) -> None:
    times = 300.0 * np.arange(100)
    learner = talc.Learner().fit(days.inputs[:50], days.measured[:50], times[:50])
    with pytest.raises(ValueError, match="row 0 is not later than the last row before it"):
        learner.predict(days.inputs[:50], times=times[:50])
    with pytest.raises(ValueError, match="fitted to rows with times; these have none"):
        learner.predict(days.inputs[50:60])
    with pytest.raises(talc.NotFittedError, match="call fit first"):
        talc.Learner().predict(days.inputs[:3])


def test_other_errors_than_before_are_refused(days: ThermalSeries) -> None:
    learner = talc.Learner().fit(days.inputs[:50], pd.DataFrame(days.measured[:50], columns=list(THERMAL_ERRORS)))
    with pytest.raises(ValueError, match="y has 2 columns: expected EY0A, EZ0A"):
        learner.partial_fit(days.inputs[50:60], days.measured[50:60, :2])
