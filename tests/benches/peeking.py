"""Detects methods of the recordings' benchmark that use measurements which they were not given."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from benchmarks.recordings.methods import Given, Method
from benchmarks.recordings.policy import Deciding

_MOVED = 1000.0
"""How far measurements are shifted to detect methods that used them too early: standard uncertainties."""


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
