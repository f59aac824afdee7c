"""The gateway's learner with scikit-learn's conventions, for any number of errors."""

from collections.abc import Iterator, Mapping, Sequence
from copy import deepcopy
from typing import Any, Self

import numpy as np

from talc.estimators.clock import RowClock
from talc.estimators.conventions import Conventions, not_fitted
from talc.estimators.rows import (
    Inputs,
    input_rows,
    names_or_numbers,
    outputs_of,
    refuse_other_units,
    warn_if_tiny,
    warn_if_within,
)
from talc.frame import LARGEST_ERROR, LARGEST_INPUT, FloatArray
from talc.learner import RowLearner


class Learner(Conventions):
    """Errors as weighted lags of the inputs, learnt at every measurement (docs/control.md).

    Rows are a time series: what one row leads to depends on the rows before it. `fit` starts again, `partial_fit` goes
    on, and `predict` takes the rows that follow the fitted ones, without learning from them or remembering them.

    Nothing is tuned to the data. Sizes count in µm: it expects errors from one to some hundreds, and believes no
    measurement to be better than 0.25.

    Parameters
    ----------
    step_s : float or None
        Grid step, s. None: the median spacing of the rows' times, or 300 s where they have none.
    noise : float, sequence of float, mapping or None
        Standard uncertainty of a measurement, of all errors or of each, in the unit of y. A mapping from names of y's
        columns holds some or all; the others, and None: 1 µm.
    unit_um : float
        Size of the unit of y, µm: 1000 for errors in mm.

    Attributes
    ----------
    error_names_ : tuple of str
        Columns of y; y0, y1, ... where they have no names.
    feature_names_in_ : ndarray of str
        Columns of X, where they have names.
    n_features_in_ : int
        Number of inputs.
    step_s_ : float
        Grid step in use, s.

    Examples
    --------
    Two temperatures and one error, of which every sixth row is measured:

    >>> import numpy as np
    >>> import talc
    >>> t = np.arange(600)
    >>> X = np.column_stack([20 + 5 * np.sin(t / 60), 20 + 3 * np.cos(t / 90)])
    >>> truth = 4 * (X[:, 0] - 20)
    >>> y = np.where(t % 6 == 0, truth, np.nan)
    >>> learner = talc.Learner(noise=0.5).fit(X[:500], y[:500])
    >>> mean, std = learner.predict(X[500:], return_std=True)
    >>> bool(np.sqrt(np.mean((mean - truth[500:]) ** 2)) < 0.1 * np.std(truth))
    True
    """

    _poor_score = True

    def __init__(
        self,
        *,
        step_s: float | None = None,
        noise: float | Sequence[float] | Mapping[str, float] | None = None,
        unit_um: float = 1.0,
    ) -> None:
        self.step_s = step_s
        self.noise = noise
        self.unit_um = unit_um

    def fit(self, X: object, y: object, times: object = None) -> Self:
        """Learn from rows, from the beginning.

        X: (T, n) array or DataFrame; NaN: missing. y: (T,) or (T, m) array, Series or DataFrame; NaN where nothing was
        measured. times: (T,) UTC seconds or datetimes, ascending; None: X's DatetimeIndex, or rows without gaps.
        ValueError and TypeError say what is wrong with them.
        """
        measured, names, flat = outputs_of(y, X)
        if not np.isfinite(measured).any():
            raise ValueError("y holds no measurement: all of it is NaN")
        refuse_other_units(names or (), self.unit_um)
        warn_if_tiny(measured * self.unit_um, "y")
        begun = self._begin(input_rows(X, times), measured, names, flat)
        if self.noise is not None:
            warn_if_within(measured, np.asarray(self._noise(self.error_names_), dtype=np.float64))
        return begun

    def partial_fit(self, X: object, y: object, times: object = None) -> Self:
        """Learn from the rows that follow, measured or not; the first time from the beginning, as `fit`."""
        measured, names, flat = outputs_of(y, X)
        if not hasattr(self, "_learner"):
            refuse_other_units(names or (), self.unit_um)
            return self._begin(input_rows(X, times), measured, names, flat)
        rows = self._following(X, times)
        expected = len(self.error_names_)
        if measured.shape[1] != expected or (names is not None and names != self.error_names_):
            found = ", ".join(names) if names else f"{measured.shape[1]} columns"
            raise ValueError(f"y has {found}: expected {', '.join(self.error_names_)}")
        return self._go_on(rows, measured)

    def new_reference(self) -> Self:
        """Errors count from the latest row, in which they are zero: the part was clamped again, or a run has ended.

        What was learnt of the inputs stays. The rows that follow go to `partial_fit` or `predict`.
        """
        if not hasattr(self, "_learner"):
            raise not_fitted(self)
        self._learner.new_reference()
        return self

    def predict(self, X: object, return_std: bool = False, times: object = None) -> Any:
        """What the errors are in the rows that follow the fitted ones: (T,) or (T, m), in the unit of y.

        return_std: also their standard uncertainties, of the same shape. Before its first measurement an error is 0.
        """
        found = [learner.estimate() for learner in self._ahead(X, times)]
        # An error is a deviation from the reference: 0 before its first measurement.
        mean = np.nan_to_num(np.array([e.value for e in found])) / self.unit_um
        std = np.array([e.sigma for e in found]) / self.unit_um
        if self._flat:
            mean, std = mean[:, 0], std[:, 0]
        return (mean, std) if return_std else mean

    def contributions(self, X: object, times: object = None) -> FloatArray:
        """(T, m, n + 1) what each input adds to each prediction, in the unit of y; the last: what no input explains.

        Over the last axis they add up to `predict(X)`.
        """
        found = [learner.explain() for learner in self._ahead(X, times)]
        return np.array([np.column_stack([why.inputs, why.level]) for why in found]) / self.unit_um

    def _begin(self, rows: Inputs, measured: FloatArray, names: tuple[str, ...] | None, flat: bool) -> Self:
        m, n = measured.shape[1], rows.values.shape[1]
        error_names = names_or_numbers(names, m, "y")
        wanted = self._noise(error_names)
        try:
            given = np.asarray(wanted, dtype=np.float64)
        except (TypeError, ValueError):
            raise TypeError(f"noise = {self.noise!r}: expected a number, or one for each column of y") from None
        if given.shape not in ((), (1,), (m,)):
            raise ValueError(f"noise has {given.size} values: expected one, or one for each of the {m} columns of y")
        noise = np.broadcast_to(given, (m,)) * self.unit_um
        if not (noise > 0).all():
            raise ValueError(f"noise = {self.noise!r}: expected more than 0")
        clock = RowClock(rows, self.step_s)
        self._clock, self._learner, self._flat = clock, RowLearner(n, clock.step_s, noise.copy()), flat
        self._k = -1
        self._know(rows)
        self.step_s_ = clock.step_s
        self.error_names_ = error_names
        return self._go_on(rows, measured)

    def _noise(self, error_names: Sequence[str]) -> float | Sequence[float]:
        """In the unit of y, of all errors or of each. ValueError: it names another column."""
        usual = 1.0 / self.unit_um
        if not isinstance(self.noise, Mapping):
            return usual if self.noise is None else self.noise
        for name in self.noise:
            if name not in error_names:
                raise ValueError(f"noise names {name!r}: y has {', '.join(error_names)}")
        return [self.noise.get(name, usual) for name in error_names]

    def _ahead(self, X: object, times: object) -> Iterator[RowLearner]:
        """A copy of what is known, at each of the rows that follow."""
        if not hasattr(self, "_learner"):
            raise not_fitted(self)
        rows = self._following(X, times)
        learner, last = deepcopy(self._learner), self._k
        for k, values in zip(self._clock.ahead().take(rows).tolist(), rows.values, strict=True):
            _advance(learner, values, k - last - 1)
            last = k
            yield learner

    def _go_on(self, rows: Inputs, measured: FloatArray) -> Self:
        if len(measured) != len(rows.values):
            raise ValueError(f"X has {len(rows.values)} rows, y {len(measured)}: expected the same number")
        errors = measured * self.unit_um
        too_large = np.argwhere(np.abs(errors) > LARGEST_ERROR)
        if too_large.size:
            row, j = (int(i) for i in too_large[0])
            raise ValueError(
                f"y: row {row} of {self.error_names_[j]} is {measured[row, j]:g}: expected at most a metre"
            )
        unknown = np.full(errors.shape[1], np.nan)
        for k, values, error in zip(self._clock.take(rows).tolist(), rows.values, errors, strict=True):
            _advance(self._learner, values, k - self._k - 1)
            if np.isfinite(error).any():
                self._learner.learn(error, unknown)
            self._k = k
        return self


def _advance(learner: RowLearner, values: FloatArray, gap: int) -> None:
    valid = np.abs(values) <= LARGEST_INPUT  # NaN compares false
    learner.advance(np.where(valid, values, 0.0), valid, gap)
