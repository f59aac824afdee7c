"""One running model: its state between measurements, and its prediction for the present step."""

from dataclasses import dataclass

import numpy as np

from talc.frame import FloatArray
from talc.models import ErrorModel

_WARM_UP_STEPS = 288
"""Rows from which a new model's history is built: longer than most of a model's memory, which is steps too (a
day at 5 min)."""

ModelState = list[list[float]]


@dataclass(frozen=True, slots=True)
class ErrorEstimate:
    """The estimate of one error at one step; µm or µm/m."""

    predicted: float
    """Before this step's measurement."""
    corrected: float
    """After it; the same without a measurement."""
    sigma: float
    """Standard uncertainty of `corrected`."""
    novelty: float
    """Leverage of the inputs relative to the largest in training; above 1: beyond the training data."""
    bounded: bool
    """An input or the output was outside the model's bounds and was held at them."""


class FreeRunningModel:
    """A model with its state. Between measurements its past outputs are its own predictions.

    Parameters
    ----------
    model: as adopted
    columns: positions of the model's inputs in the frame
    """

    def __init__(self, model: ErrorModel, columns: list[int]) -> None:
        self.model = model
        self._columns = columns
        self._runner = model.runner()
        self._runner.start(model.y_mean)

    def warm_up(self, inputs: FloatArray, measured: FloatArray) -> None:
        """Build the state from (T, n) inputs and (T,) measurements that ended with the present step."""
        inputs, measured = inputs[-_WARM_UP_STEPS:], measured[-_WARM_UP_STEPS:]
        known = np.flatnonzero(np.isfinite(measured))
        if known.size == 0:
            return
        first = int(known[0])
        self._runner.start(float(measured[first]))
        rows = self._filled(inputs[first:])
        # The fit has seen these measurements: they build the state, but contain no information about the disturbance.
        self._runner.run(rows, np.ascontiguousarray(measured[first:]), False, np.empty(len(rows)))

    def step(self, inputs: FloatArray, measured: float) -> ErrorEstimate:
        """Advance one step. inputs: (n,) this step's row; measured: NaN without a measurement."""
        return ErrorEstimate(*self._runner.step(self._filled(inputs), measured, True))

    def state(self) -> ModelState:
        """What `restore` takes."""
        return self._runner.state()

    def restore(self, state: ModelState) -> None:
        """Continue from a state of the same model. ValueError: any other state."""
        self._runner.restore(state)

    def _filled(self, rows: FloatArray) -> FloatArray:
        """The model's columns; an input that never had a good value is held at training's mean."""
        own = rows[..., self._columns]
        return np.ascontiguousarray(np.where(np.isfinite(own), own, self.model.u_mean))
