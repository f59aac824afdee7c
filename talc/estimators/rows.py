"""Reads what users give, NumPy or pandas, into arrays with names and times. pandas is recognised, never imported."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Any
from warnings import warn

import numpy as np

from talc.frame import FloatArray
from talc.names import TINY_UM
from talc.units import COLUMN_UNITS, named_unit

_TIMES = ("M", "m")
"""NumPy's letters of moments, and of times since some beginning."""
_TEXT = "times: row {row} is the text {time!r}: expected seconds or datetimes; pandas.to_datetime reads text"
_HOUR_S = 3600.0
_SHORTEST_S = 60.0
"""Shorter median spacings of plain numbers may be minutes, hours or days that were given as seconds."""
_TWICE = '; if summer time ended there, tz_localize(zone, ambiguous="infer") tells the repeated hour from the first'


@dataclass(frozen=True, slots=True, eq=False)
class Inputs:
    """The rows of X."""

    values: FloatArray
    """(T, n) NaN: missing."""
    names: tuple[str, ...] | None
    """Names of the columns, if they have any."""
    time_s: FloatArray | None
    """(T,) UTC seconds, ascending, if rows have times."""
    zoned: bool | None = None
    """Whether the times are dates with a time zone, or dates without one; None: neither, such as seconds."""
    counted: bool = False
    """The times are plain numbers, whose unit nothing says."""


def warn_if_tiny(measured_um: FloatArray, what: str, least_um: float = TINY_UM) -> None:
    """Warns where all errors are so small that they are hardly in µm: they would be predicted as 0 in silence."""
    largest = float(np.max(np.abs(measured_um), initial=0.0, where=np.isfinite(measured_um)))
    if 0.0 < largest <= least_um:
        text = f"{what} is at most {largest:.2g} µm, too little to be predicted; if it is in mm, give unit_um=1000"
        warn(text, stacklevel=3)


def warn_if_within(measured: FloatArray, noise: FloatArray) -> None:
    """Warns where no measurement of any error is larger than the noise, both in one unit: nothing would be learnt."""
    largest = np.max(np.abs(measured), axis=0, initial=0.0, where=np.isfinite(measured))
    if (largest <= noise).all():
        text = f"y is at most {largest.max():.2g}, noise {noise.max():.2g}: too little to be predicted"
        warn(f"{text}; noise is in the unit of y", stacklevel=3)


def more_than_zero(name: str, value: object) -> None:
    """TypeError: it is not a number. ValueError: it is not more than 0."""
    if not isinstance(value, Real):
        raise TypeError(f"{name} = {value!r}: expected a number")
    if not float(value) > 0:
        raise ValueError(f"{name} = {value!r}: expected more than 0")


def refuse_other_units(columns: Sequence[object], unit_um: float) -> None:
    """ValueError: a column of errors is named with a unit (`dz_mm`) of another size than unit_um."""
    more_than_zero("unit_um", unit_um)
    for name in columns:
        said = named_unit(name) if isinstance(name, str) else ""
        if said and not math.isclose(COLUMN_UNITS[said][1], unit_um, rel_tol=1e-9):
            size = COLUMN_UNITS[said][1]
            raise ValueError(
                f"column {name!r}: its name says {said}, but unit_um = {unit_um:g}; give unit_um={size:.12g} "
                "(errors in several units: convert them), or rename the column"
            )


def refuse_unsure_seconds(rows: Inputs, step_s: float) -> None:
    """ValueError: times are plain numbers so dense that they may be minutes; step_s: what to give if they are not."""
    if rows.counted and rows.time_s is not None and len(rows.time_s) > 1:
        apart_s = float(np.median(np.diff(rows.time_s)))
        if apart_s < _SHORTEST_S:
            raise ValueError(
                f"times: rows are {apart_s:.3g} s apart if these numbers are seconds; if they are, give "
                f"step_s={step_s:g}. Otherwise convert them: minutes times 60, or datetimes"
            )


def input_rows(X: object, times: object = None) -> Inputs:
    """The rows of a table or array. ValueError and TypeError say what is wrong with it.

    X: (T, n) array or DataFrame; times: (T,) seconds, datetime64 or a DatetimeIndex; None: those of X's own index.
    """
    if X is None:
        raise ValueError("X is None: expected a table or an array (rows, inputs)")
    if hasattr(X, "toarray"):
        raise TypeError("X is a sparse matrix or array: expected a dense one; use X.toarray()")
    columns = getattr(X, "columns", None)
    names = None
    if columns is not None and all(isinstance(name, str) for name in columns):
        names = tuple(columns)
        _once_each("X", names)
    values = _numbers(X, "X")
    if values.ndim != 2:
        raise ValueError(
            f"X has shape {values.shape}: expected a 2D array (rows, inputs). Reshape your data with "
            "X.reshape(-1, 1) if there is one input, X.reshape(1, -1) if there is one row"
        )
    if not values.shape[0]:
        raise ValueError(f"Found array with 0 sample(s) (shape={values.shape}) while a minimum of 1 is required.")
    if not values.shape[1]:
        raise ValueError(f"Found array with 0 feature(s) (shape={values.shape}) while a minimum of 1 is required.")
    if np.isinf(values).any():
        row, column = (int(i) for i in np.argwhere(np.isinf(values))[0])
        where = f"column {names[column]!r}" if names else f"column {column}"
        raise ValueError(f"Input X contains infinity, row {row}, {where}; a missing value is NaN")
    times = _index_of(X) if times is None else times
    if times is None:
        return Inputs(values, names, None)
    return Inputs(values, names, seconds_of(times, len(values)), zoned_of(times), _counted(times))


def outputs_of(y: object, X: object = None) -> tuple[FloatArray, tuple[str, ...] | None, bool]:
    """(T, m) measured errors with NaN where there is none, their names if they have any, and whether y is one column.

    y: (T,) or (T, m) array, Series or DataFrame; its DatetimeIndex, if any, is that of X. ValueError and TypeError say
    what is wrong with it.
    """
    if y is None:
        raise ValueError("requires y to be passed, but the target y is None")
    _same_times(X, y)
    columns, name = getattr(y, "columns", None), getattr(y, "name", None)
    names = None
    if columns is not None and all(isinstance(column, str) for column in columns):
        names = tuple(columns)
        _once_each("y", names)
    elif isinstance(name, str):
        names = (name,)
    values = _numbers(y, "y")
    if values.ndim not in (1, 2) or (values.ndim == 2 and not values.shape[1]):
        raise ValueError(f"y has shape {values.shape}: y should be a 1d array, or 2d (rows, errors)")
    if not len(values):
        raise ValueError("y has no rows")
    if np.isinf(values).any():
        raise ValueError("Input y contains infinity or a value too large; where nothing was measured it is NaN")
    return np.ascontiguousarray(values.reshape(len(values), -1)), names, values.ndim == 1


def seconds_of(times: object, rows: int) -> FloatArray:
    """(rows,) UTC seconds. ValueError: another number of times, or they do not ascend.

    times: numbers in seconds, datetime64, timedelta64, or an index of pandas of one of these; without a time zone UTC.
    """
    if getattr(times, "tz", None) is not None:
        times = times.tz_convert(None)  # type: ignore[attr-defined]
    found: Any = np.asarray(times)
    if found.dtype.kind == "O":  # datetime objects
        found = np.array([_second(t, row) for row, t in enumerate(found.tolist())])
    elif found.dtype.kind in _TIMES:
        whole = "timedelta64[ns]" if found.dtype.kind == "m" else "datetime64[ns]"
        found = np.where(np.isnat(found), np.nan, found.astype(whole).astype(np.int64) / 1e9)
    elif found.dtype.kind in "US":
        raise TypeError(_TEXT.format(row=0, time=str(found.flat[0]) if found.size else ""))
    found = np.asarray(found, dtype=np.float64)
    if found.shape != (rows,):
        raise ValueError(f"times has shape {found.shape}: expected ({rows},), one for each row")
    bad = np.flatnonzero(~np.isfinite(found))
    if bad.size:
        raise ValueError(f"times: row {int(bad[0])} has no time")
    back = np.flatnonzero(np.diff(found) <= 0.0)
    if back.size:
        repeats = found[back[0] + 1] - found[back[0]] >= -_HOUR_S
        raise ValueError(
            f"times: row {int(back[0]) + 1} is not later than the row before it; sort the rows by time"
            + (_TWICE if repeats else "")
        )
    return np.asarray(found, dtype=np.float64)


def zoned_of(times: object) -> bool | None:
    """Whether times are dates with a time zone, or dates without one; None: neither."""
    if hasattr(getattr(times, "dt", None), "tz"):  # a column of dates
        times = times.dt  # type: ignore[attr-defined]
    if hasattr(times, "tz"):
        return times.tz is not None
    found = np.asarray(times)
    if found.dtype.kind == "O" and found.size and hasattr(found.flat[0], "tzinfo"):
        return found.flat[0].tzinfo is not None
    return False if found.dtype.kind == "M" else None


def _counted(times: object) -> bool:
    return np.asarray(times).dtype.kind in "iuf"


def names_or_numbers(names: Sequence[str] | None, count: int, letter: str) -> tuple[str, ...]:
    """The names, or a letter with a number each."""
    return tuple(names) if names is not None else tuple(f"{letter}{i}" for i in range(count))


def _once_each(letter: str, names: tuple[str, ...]) -> None:
    twice = {name for name in names if names.count(name) > 1}
    if twice:
        raise ValueError(f"{letter}: column {sorted(twice)[0]!r} occurs twice")


def _index_of(table: object) -> Any:
    """Its DatetimeIndex or TimedeltaIndex; None without one."""
    index = getattr(table, "index", None)
    kind = getattr(getattr(index, "dtype", None), "kind", None)
    return index if kind in _TIMES else None


def _same_times(X: object, y: object) -> None:
    """Raises ValueError: rows of the same place have other times. Another number of rows is reported elsewhere."""
    own, others = _index_of(X), _index_of(y)
    if own is None or others is None or len(own) != len(others):
        return
    try:
        apart = np.flatnonzero(np.asarray(own != others))
    except TypeError:
        raise ValueError(
            "of X and y one has times with a time zone and the other without: give both the same"
        ) from None
    if apart.size:
        row = int(apart[0])
        raise ValueError(
            f"row {row} is of {own[row]} in X and of {others[row]} in y; y.reindex(X.index) puts them side by side"
        )


def _second(time: Any, row: int) -> float:
    """A number of seconds, or a datetime; without a time zone it is UTC. TypeError: text."""
    if isinstance(time, str):
        raise TypeError(_TEXT.format(row=row, time=time))
    if hasattr(time, "timestamp"):
        return float(time.timestamp() if time.tzinfo else np.datetime64(time, "ns").astype(np.int64) / 1e9)
    return float(time)


def _numbers(table: object, name: str) -> FloatArray:
    raw = np.asarray(table)
    if raw.dtype.kind == "c" or (raw.dtype.kind == "O" and any(isinstance(v, complex) for v in raw.ravel())):
        raise ValueError(f"Complex data not supported: {name} holds complex numbers")
    if raw.dtype.kind in "Mm":
        raise TypeError(f"{name} holds dates: expected numbers; give them as times")
    try:
        return _floats(raw)
    except (TypeError, ValueError) as error:
        columns = getattr(table, "columns", None)
        if columns is None:
            raise
        column, kind = _first_without_numbers(table, columns)
        if kind in _TIMES:
            raise TypeError(f"{name}, column {column!r} holds dates: expected numbers; give them as times") from None
        raise type(error)(f"{name}, column {column!r}: {error}") from error


def _floats(raw: Any) -> FloatArray:
    """With NaN for pandas' `NA`, which nullable columns have."""
    if raw.dtype.kind == "O":
        missing = np.array([type(value).__name__ == "NAType" for value in raw.ravel()], dtype=np.bool_)
        raw = np.where(missing.reshape(raw.shape), np.nan, raw)
    return np.asarray(raw, dtype=np.float64)


def _first_without_numbers(table: Any, columns: Any) -> tuple[object, str]:
    """The first column that holds something else, and the letter of what its dtype is."""
    for column in columns:
        try:
            _floats(np.asarray(table[column], dtype=object))
        except (TypeError, ValueError):
            return column, getattr(table[column].dtype, "kind", "")
    return columns[0], ""
