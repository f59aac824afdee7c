"""Forecasts the estimates for the next hours, and compares earlier forecasts with what happened."""

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from talc.frame import FloatArray

_MEMORY_S = 3 * 86400.0
"""Over which the misses are remembered."""


@dataclass(frozen=True, slots=True, eq=False)
class Forecast:
    """The estimates at S later steps, µm and µm/m. NaN: not known before the first measurement of an error."""

    k: int
    """The step that it is made at."""
    steps: tuple[int, ...]
    """(S,) how far ahead; ahead_s (S,) in seconds."""
    ahead_s: tuple[float, ...]
    value: FloatArray
    """(S, 9) if the inputs stay as they are; likewise its sigma."""
    sigma: FloatArray
    measured_sigma: FloatArray
    """(S, 9) the same if the machine is measured now."""
    usual_value: FloatArray
    """(S, 9) if the inputs have their mean of the last two weeks from now on; likewise usual_sigma."""
    usual_sigma: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class PlannedForecast:
    """The estimates at S later steps under a planned load, µm and µm/m; (S, 9) each."""

    value: FloatArray
    sigma: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Misses:
    """How far forecasts have been off; root mean squares, NaN until it is known."""

    value: FloatArray
    """(S, 9) of the value that was forecast, against the estimate when that time had come."""
    sigma: FloatArray
    """(S, 9) the same of sigma, where no measurement came meanwhile."""


@dataclass(slots=True)
class _DiscountedSum:
    """Discounted squares of one kind of forecast, (S, 9) or (S, 1) each."""

    squares: FloatArray
    weight: FloatArray
    pairs: FloatArray

    def add(self, i: int, miss: FloatArray, kept: float) -> None:
        known = np.isfinite(miss)
        self.squares[i] = np.where(known, kept * self.squares[i] + miss**2, self.squares[i])
        self.weight[i] = np.where(known, kept * self.weight[i] + 1.0, self.weight[i])
        self.pairs[i] += known

    def root(self, enough: FloatArray) -> FloatArray:
        found = np.sqrt(self.squares / np.maximum(self.weight, 1.0))
        return np.where(self.pairs >= enough, found, np.nan)


@dataclass(slots=True, eq=False)
class ForecastRecord:
    """Compares what was forecast with what came. It begins empty, and knows a time ahead when forecasts over as long a
    time have come due.

    Parameters
    ----------
    steps: (S,) how far ahead the forecasts reach, ascending
    step_s: grid step
    errors: number of errors
    """

    steps: tuple[int, ...]
    step_s: float
    errors: int = 9
    _made: deque[Forecast] = field(init=False, repr=False)
    _value: _DiscountedSum = field(init=False, repr=False)
    _sigma: _DiscountedSum = field(init=False, repr=False)
    _measured: int | None = None
    """Step of the last measurement."""

    def __post_init__(self) -> None:
        shape = (len(self.steps), self.errors)
        self._made = deque(maxlen=self.steps[-1])
        self._value, self._sigma = (_DiscountedSum(np.zeros(shape), np.zeros(shape), np.zeros(shape)) for _ in range(2))

    def take(self, forecast: Forecast, value: FloatArray, sigma: FloatArray, *, measured: bool) -> Misses:
        """Compare earlier forecasts with the (9,) estimate of this step, keep this one, and say how good they were.

        measured: whether this step had a measurement
        """
        k = forecast.k
        if measured:
            self._measured = k
        made = {old.k: old for old in self._made if old.k < k}
        for i, ahead in enumerate(self.steps):
            old = made.get(k - ahead)
            if old is None:
                continue
            kept = float(np.exp(-self.step_s / _MEMORY_S))
            self._value.add(i, value - old.value[i], kept)
            if self._measured is None or self._measured <= old.k:
                self._sigma.add(i, sigma - old.sigma[i], kept)
        self._made.append(forecast)
        enough = np.array(self.steps, dtype=np.float64)[:, None]
        return Misses(self._value.root(enough), self._sigma.root(enough))
