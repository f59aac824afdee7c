"""Sensitivities: how many micrometres a kelvin moves each error, week by week, from the gateway's store.

Not the learnt weights of single inputs: temperatures that rise together share their effect, and how they share it says
nothing about the machine. The sensitivity says how the estimates change with the temperature that they follow most
closely.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gateway.listeners.web.past import estimates_of
from gateway.listeners.web.sentences import Amount, Atom
from gateway.listeners.web.weeks import monday_of
from gateway.telemetry.answers import CoursePage
from gateway.telemetry.subscriber.machine import believable
from talc.frame import FloatArray
from talc.names import ERROR_UNITS, THERMAL_ERRORS

MOST_ESTIMATES = 1000
"""Most estimates of twelve weeks: one each two hours."""
_LEAST_POINTS = 12
"""Fewest points of a week: a day."""
_LEAST_MOVED_K = 0.3
"""Standard deviation of a temperature within a week, below which there is no slope to be seen."""
_LEAST_MOVED = 0.1
"""The same of an error."""


@dataclass(frozen=True, slots=True)
class ErrorSensitivity:
    """How sensitive one thermal error is."""

    error: str
    temperature: str
    """That its estimate follows most closely."""
    unit: str
    slopes: list[Amount]
    """By week; no number where the temperature or the estimate did not change enough."""
    follows: Amount
    """Share of the estimate's changes within the weeks that the lines explain."""


@dataclass(frozen=True, slots=True)
class SensitivityWeeks:
    """What a browser is sent."""

    weeks: list[float] | None
    """Their Mondays, UTC seconds, the latest first; None: unknown."""
    errors: list[ErrorSensitivity]
    why: "Atom | None"
    """Why it is unknown."""


def sensitivity_by_week(page: CoursePage) -> SensitivityWeeks:
    """The slope of a straight line through the stored estimates over a temperature, week by week.

    Raises ValueError for columns of different lengths, or a number that is not a time.
    """
    errors, _ = estimates_of(page.errors, len(page.time))
    temperatures, mondays = _columns(page), np.array([monday_of(time) for time in page.time])
    weeks = sorted(set(mondays.tolist()), reverse=True)
    names = tuple(page.temperatures)
    if not names or not weeks:
        return SensitivityWeeks(weeks, [], None)
    by_week = [(errors[own], temperatures[own]) for own in (mondays == week for week in weeks)]
    shown = (_of_error(j, names, by_week) for j in range(len(THERMAL_ERRORS)))
    return SensitivityWeeks(weeks, [each for each in shown if each is not None], None)


def _of_error(
    j: int, names: Sequence[str], by_week: Sequence[tuple[FloatArray, FloatArray]]
) -> ErrorSensitivity | None:
    """The sensitivity of the j-th error, from its (r, 9) and the (r, t) temperatures of W weeks; None: its estimate
    hardly changed."""
    sums = [_sums(errors[:, j], temperatures) for errors, temperatures in by_week]
    n, tt, ee, te = (np.stack(each) for each in zip(*sums, strict=True))  # (W, t)
    with np.errstate(divide="ignore", invalid="ignore"):
        moved = (tt > n * _LEAST_MOVED_K**2) & (ee > n * _LEAST_MOVED**2) & (n >= _LEAST_POINTS)
        slopes = np.where(moved, te / tt, np.nan)
    changes = float(ee.max(axis=1).sum())
    if not moved.any():
        return None
    follows = np.nansum(slopes * te, axis=0) / changes
    best = int(np.argmax(follows))
    error = THERMAL_ERRORS[j]
    return ErrorSensitivity(
        error,
        names[best],
        f"{ERROR_UNITS[error]}/K",
        [Amount(float(slope) if np.isfinite(slope) else None, d=2, sign=True) for slope in slopes[:, best]],
        Amount(100.0 * float(follows[best]), "%", d=0),
    )


def _sums(error: FloatArray, temperatures: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """(t,) each, of deviations from the mean in one week: how many, temperature², error², temperature times error."""
    known = np.isfinite(temperatures) & np.isfinite(error)[:, None]
    n = known.sum(axis=0).astype(np.float64)
    t, e = (np.where(known, v, 0.0) for v in (temperatures, error[:, None]))
    most = np.maximum(n, 1.0)
    t, e = (np.where(known, v - v.sum(axis=0) / most, 0.0) for v in (t, e))
    return n, np.sum(t * t, axis=0), np.sum(e * e, axis=0), np.sum(t * e, axis=0)


def _columns(page: CoursePage) -> FloatArray:
    """(n, t) degC; NaN: unknown."""
    found = np.full((len(page.time), len(page.temperatures)), np.nan)
    for i, (name, column) in enumerate(page.temperatures.items()):
        if len(column) != len(page.time):
            raise ValueError(f"{name}: {len(column)} temperatures for {len(page.time)} times")
        found[:, i] = [believable(v) for v in column]
    return found
