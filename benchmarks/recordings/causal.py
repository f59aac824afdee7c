"""Detects methods that use measurements which had not been made yet."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from benchmarks.recordings.description import InputColumn
from benchmarks.recordings.judge import rows_to_measure
from benchmarks.recordings.methods import Given, Method, given_of
from benchmarks.recordings.policy import Deciding
from benchmarks.recordings.series import Series

_MOVED = 1000.0
"""How far measurements are shifted: standard uncertainties."""
_TRIAL_ROWS = 150


class Peeked(Exception):
    """A method's estimate is based on a measurement that had not been made yet."""


def check_causal(method: Method, given: Given, seeds: Sequence[int] = (0,)) -> None:
    """Raise Peeked if changing the measurements from some row on changes an estimate up to that row.

    seeds: one row for each
    """
    rows = np.flatnonzero(given.used)
    if len(rows) < 3:
        return
    courses = method.courses(given)
    for seed in seeds:
        row = int(np.random.default_rng([seed, 23]).choice(rows[len(rows) // 2 :]))
        other = given.measured.copy()
        other[row:] += _MOVED * given.sigma
        for course, moved in zip(courses, method.courses(replace(given, measured=other)), strict=True):
            here = slice(None, row + 1)
            # Before the row even the stated uncertainty must not know of it.
            if not (
                np.array_equal(course.estimate[here], moved.estimate[here], equal_nan=True)
                and np.array_equal(course.sigma[here], moved.sigma[here], equal_nan=True)
            ):
                raise Peeked(f"{method.name}: an estimate up to row {row} changes with the measurement of row {row}")


def check_asked(method: Deciding, given: Given, limit: float) -> None:
    """Raise Peeked if measurements that the method did not make change its estimates."""
    course, used = method.decide(given, limit)
    other = np.where(used[:, None], given.measured, given.measured + _MOVED * given.sigma)
    moved, moved_used = method.decide(replace(given, measured=other), limit)
    same = np.array_equal(course.estimate, moved.estimate, equal_nan=True) and np.array_equal(used, moved_used)
    if not same:
        raise Peeked(f"{method.name}: its estimates change with measurements that it did not ask for")


def trial() -> Given:
    """Two errors that follow slow random walks of three temperatures, measured each 5 min for 2 h, then each 30 min."""
    draw = np.random.default_rng(0)
    t = np.cumsum(draw.normal(0, 0.2, (_TRIAL_ROWS, 3)), axis=0)
    names = ("t0", "t1", "t2")
    series = Series(
        name="trial",
        step_s=300.0,
        k=np.arange(_TRIAL_ROWS),
        run=np.zeros(_TRIAL_ROWS, dtype=np.int64),
        input_names=names,
        about=tuple(InputColumn() for _ in names),
        inputs=20.0 + t,
        error_names=("e0", "e1"),
        units=("um", "um"),
        angle=np.zeros(2, dtype=np.bool_),
        truth=t @ draw.normal(0, 4.0, (3, 2)),
        noise=np.zeros(2),
        probing=np.full(2, 0.5),
        notes=(),
    )
    return given_of(series, rows_to_measure(series, 2.0, 30.0), 0, 24, 6)
