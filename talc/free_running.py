"""One model at work: its output history between measurements, and what it says of the present step."""

from dataclasses import dataclass

import numpy as np

from talc.frame import FloatArray
from talc.models import ErrorModel

_WARM_UP_STEPS = 288
"""Rows from which a new model's history is built: a day, longer than most of what a model remembers."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """One error at one step; µm or µm/m."""

    predicted: float
    """Before this step's measurement."""
    corrected: float
    """After it; the same without one."""
    sigma: float
    bounded: bool


class FreeRunningModel:
    """A model with its state. Between measurements past outputs are its own predictions.

    Parameters
    ----------
    model: as adopted
    columns: positions of the model's inputs in the frame
    """

    def __init__(self, model: ErrorModel, columns: list[int]) -> None:
        self.model = model
        self._columns = columns
        self._past = np.zeros(model.na)
        self._offset = 0.0
        """Correction of a model without memory of its own (na = 0)."""
        self._age = 1

    def warm_up(self, inputs: FloatArray, measured: FloatArray) -> None:
        """Build the state from (T, n) inputs and (T,) measurements that ended with the present step."""
        inputs, measured = inputs[-_WARM_UP_STEPS:], measured[-_WARM_UP_STEPS:]
        known = np.flatnonzero(np.isfinite(measured))
        if known.size == 0:
            self._past[:] = self.model.y_mean
            return
        first = int(known[0])
        self._past[:] = measured[first]
        for row in range(first, len(inputs)):
            self.step(inputs[: row + 1], float(measured[row]))

    def step(self, inputs: FloatArray, measured: float) -> Estimate:
        """Go one step on. inputs: (T, n) filled rows up to this step; measured: NaN without a measurement."""
        answer = self.model.step(self._past, self._window(inputs))
        predicted = answer.value + self._offset
        sigma = self.model.sigma(self._age)
        if self.model.na:
            self._past = np.concatenate([[predicted], self._past[:-1]])
        corrected = predicted
        if np.isfinite(measured):
            corrected = self._update(predicted, measured)
            self._age = 1
            sigma = self.model.sigma(0)
        else:
            self._age += 1
        return Estimate(predicted, corrected, sigma, answer.bounded)

    def _update(self, predicted: float, measured: float) -> float:
        if self.model.na:
            self._past = self.model.state_update(self._past, measured, self._age)
            return float(self._past[0])
        gain = float(self.model.gains[min(self._age, self.model.gains.size) - 1])
        self._offset += gain * (measured - predicted)
        return predicted + gain * (measured - predicted)

    def _window(self, inputs: FloatArray) -> FloatArray:
        """(lags, n) most recent first. Before the record began: its first row; an input never seen: training's mean."""
        rows = np.maximum(len(inputs) - 1 - np.arange(self.model.lags), 0)
        window = inputs[rows][:, self._columns]
        return np.where(np.isfinite(window), window, self.model.u_mean)
