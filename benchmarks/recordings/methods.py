"""The interface of a method, what it is given and what it returns, and the methods that need no model."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from benchmarks.recordings.description import InputColumn
from benchmarks.recordings.series import Series, steps_on
from talc.frame import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Given:
    """Everything that a method may know; of the truth, only the measurements."""

    step_s: float
    k: IntArray
    """(T,) grid index."""
    run: IntArray
    """(T,) number of the run."""
    input_names: tuple[str, ...]
    about: tuple[InputColumn, ...]
    inputs: FloatArray
    """(T, n); NaN without a value."""
    angle: BoolArray
    """(m,) in µm/m, not in µm."""
    measured: FloatArray
    """(T, m); NaN in a row without a measurement. The estimate of a row must not be based on its own measurement."""
    sigma: FloatArray
    """(m,) standard uncertainty of a measurement."""
    dense_steps: int
    """Grid steps at the beginning with a measurement at every step."""
    interval_steps: int
    """Grid steps between measurements after that."""
    measure_first: bool = True
    """Whether each run begins with a measurement, also where the method decides."""
    zero_each_run: bool = False

    @property
    def new_reference(self) -> BoolArray:
        """(T,) rows from which on errors count from themselves, the first row aside."""
        return np.asarray((np.diff(self.run, prepend=self.run[0]) != 0) & self.zero_each_run)

    @property
    def used(self) -> BoolArray:
        """(T,) rows with a measurement."""
        return np.asarray(np.isfinite(self.measured).any(axis=1))

    @property
    def on_steps(self) -> IntArray:
        """(T,) grid steps since the beginning, not counting those between runs."""
        return steps_on(self.k, self.run)


@dataclass(frozen=True, slots=True, eq=False)
class MethodCourse:
    """The result of a method."""

    estimate: FloatArray
    """(T, m) the estimate in each row, before its own measurement; NaN: none, so nothing is corrected."""
    sigma: FloatArray
    """(T, m) standard deviation of the truth about it; NaN: not stated."""


class Method(Protocol):
    """A way to estimate errors between measurements."""

    @property
    def name(self) -> str: ...

    def courses(self, given: Given) -> Sequence[MethodCourse]:
        """One course; several if the best is chosen in hindsight; none if the method cannot start from this."""
        ...


def given_of(
    series: Series, used: BoolArray, seed: int, dense_steps: int, interval_steps: int, measure_first: bool = True
) -> Given:
    """The series with measurements in the used rows only. A row's noise does not depend on the other rows used."""
    draw = np.random.default_rng([seed, 17]).normal(size=series.truth.shape)
    measured = np.where(used[:, None], series.truth + series.probing * draw, np.nan)
    return Given(
        step_s=series.step_s,
        k=series.k,
        run=series.run,
        input_names=series.input_names,
        about=series.about,
        inputs=series.inputs,
        angle=series.angle,
        measured=measured,
        sigma=np.hypot(series.noise, series.probing),
        dense_steps=dense_steps,
        interval_steps=interval_steps,
        measure_first=measure_first,
        zero_each_run=series.zero_each_run,
    )


@dataclass(frozen=True, slots=True)
class Nothing:
    """No compensation."""

    name: str = "none"

    def courses(self, given: Given) -> Sequence[MethodCourse]:
        return [MethodCourse(np.zeros(given.measured.shape), np.full(given.measured.shape, np.nan))]


@dataclass(frozen=True, slots=True)
class HoldLast:
    """The last measurement of each error; at a new reference 0."""

    name: str = "hold"

    def courses(self, given: Given) -> Sequence[MethodCourse]:
        estimate = np.full(given.measured.shape, np.nan)
        for e, measured in enumerate(given.measured.T):
            rows = np.arange(len(measured))
            last = np.maximum.accumulate(np.where(np.isfinite(measured), rows, -1))
            before = np.concatenate([[-1], last[:-1]])
            estimate[:, e] = np.where(before >= 0, measured[before], np.nan)
            # Before the first measurement from a new reference, the error is still what it is at the reference: zero.
            counted = np.maximum.accumulate(np.where(given.new_reference, rows, -1))
            estimate[before < counted, e] = 0.0
        return [MethodCourse(estimate, np.full(estimate.shape, np.nan))]
