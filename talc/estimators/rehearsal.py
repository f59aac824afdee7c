"""The learner's control over a recording, as if it were live: when it measures, what it predicts, how sure it is."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from talc.estimators.rows import (
    Inputs,
    input_rows,
    more_than_zero,
    refuse_other_units,
    refuse_unsure_seconds,
    warn_if_tiny,
)
from talc.frame import LARGEST_ERROR, Decision, FloatArray, Frame, IntArray
from talc.learner import LearningCourse
from talc.names import called_an_error, like_an_error, resembles_error
from talc.settings import LearnerSettings
from talc.steps import means_and_lasts, measured_together, on_grid

if TYPE_CHECKING:
    import pandas

Policy = Literal["uncertainty", "fixed", "every"]

_OF_A_DECISION = ("predicted", "corrected", "sigma")
"""Columns of the result for each error, from the decisions."""
_OF_A_STEP = ("phase", "measured", "wanted")
_STEP_S = 300.0
_FEW_STEPS = 12
"""A table of as many rows that fills fewer steps has times in another unit."""

_ROLE_NEEDED = "as an input it may explain the error by itself. Name it among errors, drop it, or give inputs=[...]"


def rehearse(
    df: "pandas.DataFrame",
    *,
    errors: Sequence[str],
    inputs: Sequence[str] | None = None,
    times: object = None,
    policy: Policy = "uncertainty",
    step_s: float | None = None,
    settings: LearnerSettings | None = None,
    unit_um: float = 1.0,
) -> "pandas.DataFrame":
    """What the learner would have made of a recording, had it run while the machine did. Needs pandas.

    A recorded error reaches it only when it has asked for a measurement, as on a machine; the others are there to judge
    it by. So a densely recorded table shows what few measurements would have achieved.

    Parameters
    ----------
    df : DataFrame
        A row per time; NaN: missing, or not measured.
    errors : sequence of str
        Columns with errors, µm or µm/m; in another unit, give `unit_um`.
    inputs : sequence of str or None
        Columns with inputs; None: all others.
    times : array, str or None
        (T,) UTC seconds or datetimes, ascending, or the name of a column with them; None: the DatetimeIndex, or rows
        `step_s` apart.
    policy : {'uncertainty', 'fixed', 'every'}
        When it measures: when it is unsure; at the settings' `measurement_interval_steps`; or at every recorded error.
    step_s : float or None
        Grid step, s; None: 300. Denser rows are averaged; rows that are further apart keep their own spacing.
    settings : LearnerSettings or None
        Limits, intervals and noise, in µm and µm/m; `policy` takes the place of theirs.
    unit_um : float
        Size of the errors' unit, µm (or µm/m), also in the result: 1000 for mm or mrad.

    Returns
    -------
    DataFrame
        A row per step that has any. For each error E: `E` as recorded, `E_predicted` before this step's measurement,
        `E_corrected` after it (what a machine would be corrected by), `E_sigma` its standard uncertainty, `E_measured`
        (NaN where it did not measure) and `E_trusted`. Then `phase`, `measured`, and `wanted`: why it wants to measure
        in the next step, or empty. Each row has the index of the last recorded row in its step.

    Raises
    ------
    ValueError
        A column is missing, has two roles, or would become an input though it looks like an error, resembles one, or
        has values only where an error has them. No error has a value, or one has the name of another column of the
        result. The name of an error's column says another unit than `unit_um`.
    TypeError
        `df` is not a DataFrame, or another argument is of a wrong type.

    Examples
    --------
    >>> import numpy as np
    >>> import pandas as pd
    >>> import talc
    >>> t = np.arange(576)
    >>> df = pd.DataFrame({"bed": 20 + 5 * np.sin(t / 60), "drift": 40 * np.sin(t / 60)})
    >>> df.index = pd.date_range("2026-03-02", periods=len(df), freq="5min")
    >>> result = talc.rehearse(df, errors=["drift"])
    >>> left = (result["drift"] - result["drift_predicted"])[288:]
    >>> bool(left.std() < 0.1 * df["drift"].std()), int(result["measured"].sum()) < 60
    (True, True)
    """
    try:
        import pandas as pd
    except ImportError:
        raise ImportError("talc.rehearse needs pandas: install talc-gateway with the extra `pandas`") from None
    if not isinstance(df, pd.DataFrame):
        raise TypeError(f"df is of type {type(df).__name__}: expected a pandas DataFrame")
    if not isinstance(settings, LearnerSettings | None):
        raise TypeError(f"settings is of type {type(settings).__name__}: expected a talc.settings.LearnerSettings")
    if isinstance(times, str):
        _present_once("times", [times], list(df.columns))
        df, times = df.drop(columns=times), df[times]
    chosen_inputs = inputs is not None
    errors, inputs = _columns(df, errors, inputs)
    _refuse_a_name_twice(errors)
    refuse_other_units(errors, unit_um)
    measured = input_rows(df[errors]).values * unit_um
    if not np.isfinite(measured).any():
        raise ValueError("errors: none of them has a value")
    warn_if_tiny(measured, "each of the errors")
    rows = input_rows(df[inputs], times)
    for i, e in () if chosen_inputs else measured_together(rows.values, measured).items():
        raise ValueError(f"column {inputs[i]!r} has values only where {errors[e]!r} has them: {_ROLE_NEEDED}")
    grid_s, index = _steps_of(rows, step_s)
    k, on_steps, recorded = means_and_lasts(index, rows.values, measured)
    _refuse_few_steps(len(df), len(k), grid_s)
    chosen = settings or LearnerSettings()
    found: dict[str, Any] = {name: [] for name in _OF_A_STEP}
    used, steps = np.full(recorded.shape, np.nan), []
    for row, (decision, taken) in enumerate(_course(k, on_steps, recorded, inputs, errors, chosen, policy, grid_s)):
        used[row] = recorded[row] if taken else np.nan
        steps.append(decision)
        found["phase"].append(decision.phase.value)
        found["measured"].append(taken)
        found["wanted"].append("" if decision.measure is None else decision.measure.value)
    table: dict[str, Any] = {}
    for j, error in enumerate(errors):
        table[error] = recorded[:, j] / unit_um
        for name in _OF_A_DECISION:
            table[f"{error}_{name}"] = [float(getattr(d, name)[j]) / unit_um for d in steps]
        table[f"{error}_measured"] = used[:, j] / unit_um
        table[f"{error}_trusted"] = [bool(d.trusted[j]) for d in steps]
    last = np.searchsorted(index, k, side="right") - 1
    return pd.DataFrame(table | found, index=df.index[last])


def _steps_of(rows: Inputs, given_s: float | None) -> tuple[float, IntArray]:
    """The grid's step, s, and (rows,) the step of each row. ValueError: the times may be no seconds."""
    step_s = _STEP_S if given_s is None else given_s
    more_than_zero("step_s", step_s)
    if given_s is None:
        refuse_unsure_seconds(rows, step_s)
    time_s = step_s * np.arange(1.0, len(rows.values) + 1) if rows.time_s is None else rows.time_s
    step_s, _, index = on_grid(time_s, step_s)
    return step_s, index


def _course(
    k: IntArray,
    inputs: FloatArray,
    errors: FloatArray,
    input_names: list[str],
    error_names: list[str],
    settings: LearnerSettings,
    policy: Policy,
    step_s: float,
) -> Iterator[tuple[Decision, bool]]:
    """The decision of each step, and whether it was measured."""
    if policy not in ("uncertainty", "fixed", "every"):
        raise ValueError(f"policy = {policy!r}: expected uncertainty, fixed or every")
    if policy != "every":
        settings = replace(settings, policy=policy)
    course = LearningCourse(input_names, settings, step_s, errors=error_names)
    asked, nothing = True, np.full(len(error_names), np.nan)
    for row, step in enumerate(k.tolist()):
        known = np.where(np.abs(errors[row]) <= LARGEST_ERROR, errors[row], np.nan)
        taken = (asked or policy == "every") and bool(np.isfinite(known).any())
        frame = Frame(step, inputs[row], np.isfinite(inputs[row]))
        decision = course.step(frame, known if taken else nothing)
        asked = decision.measure is not None
        yield decision, taken


def _refuse_few_steps(rows: int, steps: int, step_s: float) -> None:
    if steps < _FEW_STEPS <= rows:
        what = f"{rows} rows fill {steps} steps of {step_s:g} s: expected {_FEW_STEPS} or more"
        raise ValueError(f"{what}; are the times in seconds?")


def _refuse_a_name_twice(errors: Sequence[str]) -> None:
    """ValueError: an error has the name of another column of the result."""
    made = {f"{error}_{name}" for error in errors for name in (*_OF_A_DECISION, "measured", "trusted")} | set(
        _OF_A_STEP
    )
    for error in errors:
        if error in made:
            raise ValueError(f"errors: the result already has a column {error!r}: rename this error")


def _present_once(role: str, given: Sequence[str], names: Sequence[str]) -> None:
    for name in given:
        if name not in names:
            raise ValueError(f"{role}: there is no column {name!r}; columns: {', '.join(map(str, names))}")
        if given.count(name) > 1:
            raise ValueError(f"{role}: {name!r} is named twice")


def _columns(
    df: "pandas.DataFrame", errors: Sequence[str], inputs: Sequence[str] | None
) -> tuple[list[str], list[str]]:
    """The columns with errors and those with inputs."""
    errors = [errors] if isinstance(errors, str) else list(errors)
    names = list(df.columns)
    if not errors:
        raise ValueError("errors: expected one or more columns")
    chosen = [name for name in names if name not in errors] if inputs is None else list(inputs)
    _present_once("errors", errors, names)
    _present_once("inputs", chosen, names)
    both = set(errors) & set(chosen)
    if both:
        raise ValueError(f"{sorted(both)[0]!r} is an error and an input: give it one role")
    if not chosen:
        raise ValueError("inputs: no column remains as an input")
    if inputs is None:
        for name in chosen:
            if isinstance(name, str) and like_an_error(name):
                raise ValueError(
                    f"column {name!r} looks like an error: as an input it would explain itself. Name it among errors, "
                    "or give inputs=[...]"
                )
            alike = next((e for e in errors if isinstance(name, str) and resembles_error(str(name), str(e))), None)
            if alike is not None:
                raise ValueError(f"column {name!r} resembles {alike!r}, which is an error: {_ROLE_NEEDED}")
            if isinstance(name, str) and called_an_error(name):
                raise ValueError(f"column {name!r} is an error by its name: {_ROLE_NEEDED}")
    return errors, chosen
