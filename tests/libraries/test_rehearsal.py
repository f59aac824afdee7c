"""`talc.rehearse`: a recording as if it were live, for any errors, as the gateway would have run it."""

import re
from typing import Any

import numpy as np
import pandas as pd
import pytest

import talc
from talc.control import Controller
from talc.frame import Frame, Measurement
from talc.names import THERMAL_ERRORS
from talc.settings import LearnerSettings, TalcSettings
from tests.benches.thermal_series import series


@pytest.fixture(scope="module")
def recorded() -> pd.DataFrame:
    days = series(300, 5)
    table = pd.DataFrame(days.inputs, columns=list(days.names))
    table[list(THERMAL_ERRORS)] = days.measured
    table.index = pd.date_range("2026-03-02 00:05", periods=300, freq="5min")
    return table


def test_it_decides_as_the_controller(recorded: pd.DataFrame) -> None:
    result = talc.rehearse(recorded, errors=THERMAL_ERRORS)
    inputs = recorded.drop(columns=list(THERMAL_ERRORS))
    controller, asked = Controller(list(inputs), TalcSettings()), True
    errors = recorded[list(THERMAL_ERRORS)].to_numpy()
    for k, row in enumerate(inputs.to_numpy()):
        measurement = Measurement(errors[k], np.full(9, np.nan)) if asked else None
        decision = controller.step(Frame(k, row, np.isfinite(row), measurement))
        step = result.iloc[k]
        assert bool(step["measured"]) is asked
        for name in ("predicted", "corrected", "sigma", "trusted"):
            found = [step[f"{error}_{name}"] for error in THERMAL_ERRORS]
            np.testing.assert_array_equal(np.array(found, dtype=float), getattr(decision, name).astype(float))
        asked = decision.measure is not None
        assert step["wanted"] == ("" if decision.measure is None else decision.measure.value)
    assert (result.index == recorded.index).all()
    assert 5 < result["measured"].sum() < 150


def test_plain_numbers_that_may_be_minutes_are_refused_until_the_step_is_given(recorded: pd.DataFrame) -> None:
    table = recorded.reset_index(drop=True)
    with pytest.raises(
        ValueError, match="rows are 5 s apart if these numbers are seconds; if they are, give step_s=300"
    ):
        talc.rehearse(table, errors=THERMAL_ERRORS, times=5.0 * np.arange(300))
    assert (
        len(talc.rehearse(table, errors=THERMAL_ERRORS, times=5.0 * np.arange(300), step_s=30.0)) == 51
    )  # the first row ends a step


@pytest.mark.slow
def test_policies_differ_in_what_is_measured(recorded: pd.DataFrame) -> None:
    table = recorded.drop(columns=list(THERMAL_ERRORS)[1:]).rename(columns={"EY0A": "drift"})
    settings = LearnerSettings(measurement_interval_steps=20)
    fixed = talc.rehearse(table, errors=["drift"], policy="fixed", settings=settings)
    every = talc.rehearse(table, errors=["drift"], policy="every")
    assert list(np.flatnonzero(fixed["measured"])) == list(range(0, 300, 20))
    assert every["measured"].all()
    assert fixed["drift_measured"].notna().sum() == 15


@pytest.mark.slow
def test_denser_rows_are_averaged_and_a_gap_stays_one(recorded: pd.DataFrame) -> None:
    recorded = recorded[:150]
    dense = recorded.loc[recorded.index.repeat(5)].copy()
    dense.index = pd.date_range("2026-03-02 00:01", periods=750, freq="1min")
    sparse = recorded.drop(index=recorded.index[100:140])
    dense = dense.drop(index=dense.index[500:700])
    whole = talc.rehearse(sparse, errors=THERMAL_ERRORS, policy="every")
    fine = talc.rehearse(dense, errors=THERMAL_ERRORS, policy="every")
    assert len(whole) == len(fine) == 110
    np.testing.assert_allclose(fine["EZ0A_predicted"], whole["EZ0A_predicted"], atol=1e-6)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"errors": ["EY0B"]}, "errors: there is no column 'EY0B'"),
        ({"errors": ["EY0A"]}, "column 'EZ0A' looks like an error: as an input it would explain itself"),
        ({"errors": ["EY0A"], "inputs": ["t0", "EY0A"]}, "'EY0A' is an error and an input"),
        ({"errors": []}, "errors: expected one or more columns"),
        ({"errors": THERMAL_ERRORS, "policy": "often"}, "policy = 'often': expected uncertainty, fixed or every"),
        ({"errors": THERMAL_ERRORS, "step_s": 0.0}, "step_s = 0.0: expected more than 0"),
        ({"errors": THERMAL_ERRORS, "times": "when"}, "times: there is no column 'when'"),
    ],
)
def test_what_is_wrong_is_said(recorded: pd.DataFrame, arguments: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        talc.rehearse(recorded, **arguments)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"step_s": "5min"}, "step_s = '5min': expected a number"),
        ({"unit_um": "mm"}, "unit_um = 'mm': expected a number"),
        ({"settings": {"noise": 1}}, "settings is of type dict: expected a talc.settings.LearnerSettings"),
        ({"times": ["2026-03-02 06:00"] * 300}, "times: row 0 is the text '2026-03-02 06:00': expected seconds or"),
    ],
)
def test_a_wrong_type_is_said(recorded: pd.DataFrame, arguments: dict[str, Any], text: str) -> None:
    with pytest.raises(TypeError, match=text):
        talc.rehearse(recorded, errors=THERMAL_ERRORS, **arguments)


@pytest.mark.parametrize("names", [("E", "E_predicted"), ("phase",), ("measured",), ("E_sigma", "E")])
def test_no_error_overwrites_a_column_of_the_result(recorded: pd.DataFrame, names: tuple[str, ...]) -> None:
    table = recorded.iloc[:30, :3].assign(**{name: recorded.iloc[:30, 3 + i] for i, name in enumerate(names)})
    with pytest.raises(ValueError, match=r"errors: the result already has a column '.*': rename this error"):
        talc.rehearse(table, errors=names, inputs=list(table.columns[:3]))


def test_errors_without_a_value_are_refused(recorded: pd.DataFrame) -> None:
    table = recorded.iloc[:30, :3].assign(growth=np.nan)
    with pytest.raises(ValueError, match="errors: none of them has a value"):
        talc.rehearse(table, errors=["growth"])


def test_columns_may_have_numbers_for_names(recorded: pd.DataFrame) -> None:
    table = recorded.iloc[:60, :3].assign(growth=recorded["EZ0A"])
    expected = talc.rehearse(table, errors=["growth"])
    found = talc.rehearse(table.set_axis(range(4), axis=1), errors=[3])  # type: ignore[list-item]  # as pandas does
    np.testing.assert_array_equal(found["3_predicted"], expected["growth_predicted"])


def test_a_column_may_hold_the_times(recorded: pd.DataFrame) -> None:
    table = recorded.iloc[:60, :3].assign(growth=recorded["EZ0A"]).drop(recorded.index[20:30])
    expected = talc.rehearse(table, errors=["growth"])
    found = talc.rehearse(table.rename_axis("when").reset_index(), errors=["growth"], times="when")
    pd.testing.assert_frame_equal(found.reset_index(drop=True), expected.reset_index(drop=True))


def test_an_array_has_no_columns_to_name() -> None:
    with pytest.raises(TypeError, match="df is of type ndarray: expected a pandas DataFrame"):
        talc.rehearse(np.zeros((3, 2)), errors=["drift"])


@pytest.mark.parametrize("as_index", [True, False])
def test_times_since_the_start_are_times_too(recorded: pd.DataFrame, as_index: bool) -> None:
    """With a gap, and rows 10 min apart: rows without times would follow each other every 5 min."""
    dated = recorded.iloc[::2].drop(recorded.index[100:200:2])[["EZ0A", *recorded.columns[:3]]]
    since = dated.index - dated.index[0]
    counted = dated.set_axis(since) if as_index else dated.reset_index(drop=True)
    expected = talc.rehearse(dated, errors=["EZ0A"])
    found = talc.rehearse(counted, errors=["EZ0A"], times=None if as_index else since.to_numpy())
    pd.testing.assert_frame_equal(found.reset_index(drop=True), expected.reset_index(drop=True))
    assert found["EZ0A_sigma"].notna().all()
    if as_index:
        assert list(found.index) == list(since)


@pytest.mark.parametrize(("error", "other"), [("drift1", "drift2"), ("dev_x", "dev_y"), ("Z drift", "thermal error Y")])
def test_the_neighbour_of_an_error_is_not_silently_an_input(recorded: pd.DataFrame, error: str, other: str) -> None:
    table = recorded.rename(columns={"EY0A": error, "EZ0A": other}).drop(columns=list(THERMAL_ERRORS)[2:])[:30]
    with pytest.raises(ValueError, match=f"column '{other}' resembles '{error}', which is an error: as an input"):
        talc.rehearse(table, errors=[error])
    inputs = [name for name in table.columns if name != error]
    assert f"{error}_predicted" in talc.rehearse(table, errors=[error], inputs=inputs)
    assert f"{other}_predicted" in talc.rehearse(table, errors=[error, other])


def test_times_that_are_no_seconds_are_refused(recorded: pd.DataFrame) -> None:
    table = recorded.iloc[:30, :3].assign(y=recorded["EY0A"][:30])
    days = np.arange(30) / 288.0
    with pytest.raises(ValueError, match="30 rows fill 2 steps of 300 s: expected 12 or more; are the times in sec"):
        talc.rehearse(table, errors=["y"], times=days, step_s=300.0)
    assert len(talc.rehearse(table, errors=["y"], times=86400.0 * days)) == 30
    assert len(talc.rehearse(table[:11], errors=["y"], times=days[:11], step_s=300.0)) == 2


def test_letters_and_numbers_alone_are_names_of_inputs(recorded: pd.DataFrame) -> None:
    table = recorded.iloc[:30, :3].set_axis(["x1", "x2", "a"], axis=1).assign(y=recorded["EY0A"][:30])
    assert len(talc.rehearse(table, errors=["y"])) == 30


def test_what_is_called_an_error_or_was_measured_with_one_is_not_silently_an_input(recorded: pd.DataFrame) -> None:
    table = recorded.iloc[:60, :3].assign(growth=recorded["EZ0A"][:60], other=recorded["EX0C"][:60])
    with pytest.raises(ValueError, match="column 'Drift X' is an error by its name: as an input"):
        talc.rehearse(table.rename(columns={"other": "Drift X"}), errors=["growth"])
    table.loc[np.arange(60) % 6 > 0, ["growth", "other"]] = np.nan
    with pytest.raises(ValueError, match="column 'other' has values only where 'growth' has them: as an input"):
        talc.rehearse(table, errors=["growth"])
    assert "growth_predicted" in talc.rehearse(table, errors=["growth"], inputs=list(table.columns.drop("growth")))
    assert "other_predicted" in talc.rehearse(table, errors=["growth", "other"])


@pytest.mark.slow
def test_errors_in_mm_are_predicted_in_mm(recorded: pd.DataFrame) -> None:
    table = recorded.iloc[:, :3].assign(growth=recorded["EZ0A"])
    expected = talc.rehearse(table, errors=["growth"])
    found = talc.rehearse(table.assign(growth=table["growth"] / 1000), errors=["growth"], unit_um=1000.0)
    assert (expected["growth_predicted"] != 0.0).any()
    for name in ("growth", "growth_predicted", "growth_corrected", "growth_sigma", "growth_measured"):
        np.testing.assert_allclose(1000.0 * found[name], expected[name], rtol=1e-6, atol=1e-6)
    with pytest.warns(
        UserWarning, match=r"each of the errors is at most 0\.0\d* µm, .*; if it is in mm, give unit_um=1000"
    ):
        talc.rehearse(table.assign(growth=table["growth"] / 1000), errors=["growth"])
    with pytest.warns(UserWarning, match=r"y is at most 0\.0\d* µm, too little to be predicted"):
        talc.Learner().fit(table.iloc[:, :3], table["growth"] / 1000)
    with pytest.raises(ValueError, match=r"unit_um = 0: expected more than 0"):
        talc.rehearse(table, errors=["growth"], unit_um=0)


@pytest.mark.parametrize(("name", "unit_um"), [("growth_mm", 1.0), ("growth [µm]", 1000.0), ("growth (in)", 1000.0)])
def test_a_unit_in_an_error_s_name_is_not_overlooked(recorded: pd.DataFrame, name: str, unit_um: float) -> None:
    table = recorded.iloc[:, :3].assign(**{name: recorded["EZ0A"]})
    with pytest.raises(ValueError, match=rf"column {re.escape(repr(name))}: its name says .* unit_um = {unit_um:g};"):
        talc.rehearse(table, errors=[name], unit_um=unit_um)
    with pytest.raises(ValueError, match="its name says"):
        talc.Learner(unit_um=unit_um).fit(table.iloc[:, :3], table[name])
    with pytest.raises(ValueError, match="its name says"):
        talc.Learner(unit_um=unit_um).partial_fit(table.iloc[:, :3], table[[name]])


@pytest.mark.parametrize(
    ("name", "unit_um"), [("growth_mm", 1000.0), ("growth_um", 1.0), ("m", 1.0), ("plugged_in", 1.0)]
)
def test_the_unit_that_a_name_says_may_be_given(recorded: pd.DataFrame, name: str, unit_um: float) -> None:
    table = recorded.iloc[:60, :3].assign(**{name: recorded["EZ0A"]})
    assert f"{name}_predicted" in talc.rehearse(table, errors=[name], unit_um=unit_um)
