"""The papers' estimators: what they find in a known system, and how they run on."""

import warnings
from typing import Any

import numpy as np
import pandas as pd
import pytest

import talc
from talc.frame import FloatArray

ESTIMATORS = [
    talc.GroupLassoARX(max_nb=1, max_inputs=3),
    pytest.param(talc.ClusterKernelARX(max_nb=1, max_inputs=3), marks=pytest.mark.slow),
    talc.SparseOutputError(max_nb=1, max_inputs=3),
]


def machine(steps: int, errors: int) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Four temperatures; each error is a lag of one of them, with 0.95 as its pole and its number plus 2 as gain."""
    draw = np.random.default_rng(7)
    heat = np.repeat(draw.normal(0, 1, (steps // 8 + 1, 4)), 8, axis=0)[:steps].cumsum(axis=0) * 0.1
    y: FloatArray = np.zeros((steps, errors))
    for k in range(1, steps):
        for j in range(errors):
            y[k, j] = 0.95 * y[k - 1, j] + 0.05 * (j + 2) * heat[k, j % 4]
    index = pd.date_range("2026-03-02", periods=steps, freq="5min")
    names = [f"error {j}" for j in range(errors)]
    return pd.DataFrame(heat, columns=list("abcd"), index=index), pd.DataFrame(y, columns=names, index=index)


@pytest.mark.parametrize("estimator", ESTIMATORS, ids=lambda e: type(e).__name__)
def test_the_system_is_found_and_runs_on_without_measurements(estimator: talc.GroupLassoARX) -> None:
    X, y = machine(500, 2)
    model = estimator.fit(X[:350], y[:350])
    for j, (error, name) in enumerate((("error 0", "a"), ("error 1", "b"))):
        assert name in model.inputs_[error]
        assert model.static_gains_[error][name] == pytest.approx(j + 2, rel=0.15)
    mean, std = model.predict(X[350:], return_std=True)
    assert np.sqrt(np.mean((mean - y[350:].to_numpy()) ** 2)) < 0.15 * float(y[350:].to_numpy().std())
    assert np.isfinite(std).all()


def test_more_errors_than_nine_have_a_model_each() -> None:
    X, y = machine(300, 11)
    model = talc.SparseOutputError(max_nb=0, max_inputs=2).fit(X, y)
    assert list(model.inputs_) == [f"error {j}" for j in range(11)]
    assert [model.static_gains_[f"error {j}"]["abcd"[j % 4]] for j in range(11)] == pytest.approx(
        list(range(2, 13)), rel=0.1
    )


@pytest.mark.parametrize("estimator", ESTIMATORS, ids=lambda e: type(e).__name__)
def test_errors_in_millimetres_have_the_same_model_as_in_micrometres(estimator: talc.GroupLassoARX) -> None:
    X, y = machine(500, 2)
    y = 3.0 * y + np.random.default_rng(8).normal(0.0, 0.3, y.shape)
    given: dict[str, Any] = estimator.get_params()
    um = type(estimator)(**given).fit(X[:350], y[:350])
    tolerance = {"tolerance": 0.005} if "tolerance" in given else {}
    mm = type(estimator)(**(given | tolerance | {"unit_um": 1000.0})).fit(X[:350], y[:350] / 1000.0)
    assert mm.inputs_ == um.inputs_
    assert any(um.inputs_.values())
    for error, gains in um.static_gains_.items():
        np.testing.assert_allclose(mm.poles_[error], um.poles_[error], rtol=1e-6)
        assert mm.static_gains_[error] == pytest.approx({name: g / 1000.0 for name, g in gains.items()}, rel=1e-5)
    for in_mm, in_um in zip(mm.predict(X[350:], return_std=True), um.predict(X[350:], return_std=True), strict=True):
        np.testing.assert_allclose(1000.0 * in_mm, in_um, rtol=1e-5, atol=1e-8)


def test_a_tolerance_is_in_the_unit_of_y_and_5_um_by_default() -> None:
    X, y = machine(400, 1)
    y = 20.0 * y + np.random.default_rng(8).normal(0.0, 2.0, y.shape)
    names = [
        talc.GroupLassoARX(max_nb=1, unit_um=1000.0, tolerance=t).fit(X, y / 1000.0).inputs_
        for t in (None, 0.005, 50.0)
    ]
    wide = talc.GroupLassoARX(max_nb=1, tolerance=50_000.0).fit(X, y).inputs_
    assert names[0] == names[1] == talc.GroupLassoARX(max_nb=1, tolerance=5.0).fit(X, y).inputs_
    assert names[2] == wide


def test_errors_named_with_another_unit_are_refused_and_tiny_ones_told() -> None:
    X, y = machine(60, 1)
    named = y.rename(columns={"error 0": "EX0C_mm"})
    with pytest.raises(ValueError, match=r"'EX0C_mm'.*unit_um=1000"):
        talc.GroupLassoARX(max_nb=1).fit(X, named)
    assert talc.GroupLassoARX(max_nb=1, unit_um=1000.0).fit(X, named / 1000.0).error_names_ == ("EX0C_mm",)
    with pytest.warns(UserWarning, match="in mm, give unit_um=1000"):
        talc.SparseOutputError(max_nb=1).fit(X, y * (0.1 / float(np.abs(y).to_numpy().max())))


def test_errors_of_half_a_millimetre_without_their_unit_are_told() -> None:
    X, y = machine(400, 1)
    in_mm = y * (0.5 / float(np.abs(y).to_numpy().max()))
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        talc.GroupLassoARX(max_nb=1).fit(X, in_mm)
    assert any("unit_um=1000" in str(warning.message) for warning in told)
    talc.GroupLassoARX(max_nb=1, criterion="bic").fit(X, in_mm)  # needs no scale


def test_a_model_without_inputs_is_told() -> None:
    X, y = machine(300, 1)
    noise = pd.DataFrame(np.random.default_rng(9).normal(0.0, 0.6, y.shape), columns=y.columns, index=y.index)
    with pytest.warns(UserWarning, match="error 0: the model uses no input"):
        model = talc.GroupLassoARX(max_nb=1, max_inputs=3).fit(X, noise)
    assert model.inputs_ == {"error 0": ()}


def test_a_gap_before_the_predicted_rows_is_run_through() -> None:
    X, y = machine(400, 1)
    X = X.copy()
    X.iloc[300:330] = X.iloc[299]  # what a model assumes about rows that it does not get
    model = talc.SparseOutputError(max_nb=1).fit(X[:300], y[:300])
    whole = model.predict(X[300:])
    np.testing.assert_allclose(model.predict(X[330:]), whole[30:], rtol=1e-12)


def test_arx_needs_rows_measured_one_after_another_and_output_error_does_not() -> None:
    X, y = machine(500, 1)
    later, X, y = X[400:], X[:400], y[:400]
    sixth = y[::6].reindex(y.index)
    with pytest.warns(UserWarning, match="error 0: not fitted"):
        arx = talc.GroupLassoARX(max_nb=1, max_inputs=3).fit(X, sixth)
    assert arx.inputs_ == {}
    assert arx.predict(later)[-1, 0] == pytest.approx(float(np.nanmean(sixth)))
    assert "a" in talc.SparseOutputError(max_nb=1, max_inputs=3).fit(X, sixth).inputs_["error 0"]


def test_too_few_measurements_give_the_mean_and_a_warning() -> None:
    X, y = machine(100, 2)
    y.iloc[np.arange(100) % 10 > 0, 1] = np.nan
    with pytest.warns(UserWarning, match=r"error 1: too little measured \(rows 10, inputs 4\)"):
        model = talc.SparseOutputError(max_nb=1).fit(X, y)
    later = X.copy()
    later.index = later.index + pd.Timedelta("1D")
    assert (model.predict(later)[:, 1] == y["error 1"].mean()).all()


@pytest.mark.parametrize(
    ("estimator", "text"),
    [
        (talc.GroupLassoARX(criterion="bics"), "criterion = 'bics': expected one of adapted_bic, bic, aic, mdl"),  # type: ignore[arg-type]
        (talc.GroupLassoARX(estimator="ols"), "estimator = 'ols': expected one of least_squares, guarded, refined"),  # type: ignore[arg-type]
        (talc.ClusterKernelARX(max_inputs=2.5), "max_inputs = 2.5: expected a whole number, 0 or more"),  # type: ignore[arg-type]
        (talc.GroupLassoARX(seed=-1), "seed = -1: expected a whole number, 0 or more"),
        (talc.SparseOutputError(judged_by="all"), "judged_by = 'all': expected one of unseen, seen"),  # type: ignore[arg-type]
        (talc.GroupLassoARX(max_na=9), "max_na = 9: expected 0 to 5"),
    ],
)
def test_a_parameter_that_means_nothing_is_named(estimator: talc.GroupLassoARX, text: str) -> None:
    X = np.random.default_rng(1).normal(size=(60, 2)).cumsum(axis=0)
    with pytest.raises(ValueError, match=text):
        estimator.fit(X, X[:, 0])
