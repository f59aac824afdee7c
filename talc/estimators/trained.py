"""What the estimators with trained models share: a model for each error, with scikit-learn's conventions."""

from operator import index as whole
from typing import Any, ClassVar, Literal, Self, get_args, get_origin, get_type_hints
from warnings import warn

import numpy as np

from talc.estimators.clock import RowClock
from talc.estimators.conventions import Conventions, not_fitted
from talc.estimators.rows import (
    input_rows,
    more_than_zero,
    names_or_numbers,
    outputs_of,
    refuse_other_units,
    warn_if_tiny,
)
from talc.frame import FloatArray, Frame, TrainingJob, Why
from talc.models import ErrorModel, TrainingNote
from talc.names import ERROR_UNITS, MICROMETRE, THERMAL_ERRORS, TINY_UM
from talc.papers.free_running import FreeRunningModel
from talc.papers.training import train
from talc.record import Record
from talc.settings import TrainingSettings

_PLACES = tuple(i for i, name in enumerate(THERMAL_ERRORS) if ERROR_UNITS[name] == MICROMETRE)
"""A training makes nine models; these have one tolerance, the estimator's."""
_LEAST_UM = 1.0
"""The adapted BIC holds a sum of squares at the square of this: errors that are never larger lose their inputs."""
_NOT_OF_TRAINING = ("step_s", "unit_um", "tolerance")
"""Parameters that are not, or not in this unit, in the settings of a training."""


class TrainedModels(Conventions):
    """A model for each error, from all rows at once; what its subclasses share.

    Rows are a time series. `predict` takes the rows that follow the fitted ones, in free run: without measurements.
    Missing inputs keep their last value. An error with fewer than 24 measured rows, or whose model would be unstable,
    gets the mean of what was measured, and a warning says so. Another warning names an error whose model uses no input.

    The training counts in µm, as the adapted BIC does (eq. 9); `unit_um` converts.
    """

    step_s: float | None
    unit_um: float
    _selector: ClassVar[Literal["search", "pso", "tck"]]

    def _settings(self) -> TrainingSettings:
        """What the parameters mean for a training of errors in µm. ValueError names an invalid one."""
        given: dict[str, Any] = {name: getattr(self, name) for name in self._parameters()}
        tolerance = given.get("tolerance")
        if tolerance is not None:
            more_than_zero("tolerance", tolerance)
            given["tolerance_um"] = float(tolerance) * self.unit_um
        return TrainingSettings(
            selector=self._selector, **{name: given[name] for name in given if name not in _NOT_OF_TRAINING}
        )

    def fit(self, X: object, y: object, times: object = None) -> Self:
        """Find the models.

        X: (T, n) array or DataFrame; NaN: missing. y: (T,) or (T, m) array, Series or DataFrame; NaN where nothing was
        measured. times: (T,) UTC seconds or datetimes, ascending; None: X's DatetimeIndex, or rows without gaps.
        ValueError and TypeError say what is wrong with them.
        """
        rows = input_rows(X, times)
        given, names, self._flat = outputs_of(y, X)
        refuse_other_units(names or (), self.unit_um)
        measured = given * self.unit_um
        if len(measured) != len(rows.values):
            raise ValueError(f"X has {len(rows.values)} rows, y {len(measured)}: expected the same number")
        if not np.isfinite(measured).any():
            raise ValueError("y holds no measurement: all of it is NaN")
        _check_parameters(self)
        settings, clock = self._settings(), RowClock(rows, self.step_s)
        by_scale = self._selector == "pso" and settings.criterion == "adapted_bic"
        warn_if_tiny(measured, "y", _LEAST_UM if by_scale else TINY_UM)
        index = clock.take(rows)
        self._clock, self._k = clock, int(index[-1])
        self._know(rows)
        self.step_s_ = clock.step_s
        self.error_names_ = names_or_numbers(names, measured.shape[1], "y")
        inputs = names_or_numbers(rows.names, self.n_features_in_, "x")
        record = Record(self.n_features_in_, None)
        for k, values in zip(index.tolist(), rows.values, strict=True):
            record.append_gap(k)
            record.append(Frame(k, values, np.isfinite(values)))
        on_steps = np.full((len(record), measured.shape[1]), np.nan)
        on_steps[index - index[0]] = measured
        self._last = record.inputs[-1].copy()
        self._mean = [float(np.mean(m[np.isfinite(m)])) if np.isfinite(m).any() else 0.0 for m in measured.T]
        self._models, notes = _trained(record, inputs, on_steps, settings)
        if notes:
            texts = [f"{self.error_names_[j]}: {note}; its mean is predicted" for j, note in notes]
            warn("\n".join(texts), stacklevel=2)
        self._running = [
            None if model is None else _state(model, inputs, record.inputs, on_steps[:, j])
            for j, model in enumerate(self._models)
        ]
        found = {name: model for name, model in zip(self.error_names_, self._models, strict=True) if model is not None}
        for name, model in found.items():
            if not model.inputs:
                warn(f"{name}: the model uses no input, so it predicts hardly more than the mean", stacklevel=2)
        self.inputs_ = {name: model.inputs for name, model in found.items()}
        self.poles_ = {name: model.poles() for name, model in found.items()}
        self.static_gains_ = {
            name: dict(zip(model.inputs, (model.static_gain() / self.unit_um).tolist(), strict=True))
            for name, model in found.items()
        }
        return self

    def predict(self, X: object, return_std: bool = False, times: object = None) -> Any:
        """What the errors are in the rows that follow the fitted ones: (T,) or (T, m), in the unit of y.

        return_std: also their standard uncertainties, of the same shape; NaN for an error without a model.
        """
        if not hasattr(self, "_models"):
            raise not_fitted(self)
        rows = self._following(X, times)
        index = self._clock.ahead().take(rows)
        inputs = names_or_numbers(rows.names or getattr(self, "feature_names_in_", None), self.n_features_in_, "x")
        mean, std = np.full((2, len(index), len(self._models)), np.nan)
        for j, (model, state) in enumerate(zip(self._models, self._running, strict=True)):
            if model is None or state is None:
                mean[:, j] = self._mean[j]
                continue
            running = FreeRunningModel(model, [inputs.index(name) for name in model.inputs])
            running.restore(state)
            last, k_before = self._last, self._k
            for row, (k, values) in enumerate(zip(index.tolist(), rows.values, strict=True)):
                for _ in range(k - k_before - 1):
                    running.step(last, float("nan"))
                last, k_before = np.where(np.isfinite(values), values, last), k
                estimate = running.step(last, float("nan"))
                mean[row, j], std[row, j] = estimate.predicted, estimate.sigma
        mean, std = mean / self.unit_um, std / self.unit_um
        if self._flat:
            mean, std = mean[:, 0], std[:, 0]
        return (mean, std) if return_std else mean


def _check_parameters(estimator: TrainedModels) -> None:
    """Raises ValueError for a parameter that is not one of its words, or not a whole number. The settings check
    sizes."""
    for name, kind in get_type_hints(type(estimator).__init__).items():
        value = getattr(estimator, name, None)
        if get_origin(kind) is Literal and value not in get_args(kind):
            raise ValueError(f"{name} = {value!r}: expected one of {', '.join(get_args(kind))}")
        if kind is int:
            try:
                right = whole(value) >= 0  # type: ignore[arg-type]  # what a user gave
            except TypeError:
                right = False
            if not right:
                raise ValueError(f"{name} = {value!r}: expected a whole number, 0 or more")


def _trained(
    record: Record, inputs: tuple[str, ...], measured: FloatArray, settings: TrainingSettings
) -> tuple[list[ErrorModel | None], list[tuple[int, TrainingNote]]]:
    """A model of each column, or None and why; as many at once as share their regressions."""
    models: list[ErrorModel | None] = []
    notes: list[tuple[int, TrainingNote]] = []
    for begin in range(0, measured.shape[1], len(_PLACES)):
        some = measured[:, begin : begin + len(_PLACES)]
        nine = np.full((len(measured), len(THERMAL_ERRORS)), np.nan)
        places = _PLACES[: some.shape[1]]
        nine[:, places] = some
        job = TrainingJob(
            k=len(measured) - 1,
            why=Why.CALIBRATION,
            input_names=inputs,
            inputs=record.inputs,
            valid=record.valid,
            measured=nine,
            settings=settings,
        )
        found = train(job)
        for j, place in enumerate(places):
            models.append(found.models[place])
            notes += [(begin + j, note) for note in found.notes if note.values.get("error") == THERMAL_ERRORS[place]]
    return models, notes


def _state(model: ErrorModel, inputs: tuple[str, ...], rows: FloatArray, measured: FloatArray) -> list[list[float]]:
    """The model's state at the last row."""
    running = FreeRunningModel(model, [inputs.index(name) for name in model.inputs])
    running.warm_up(rows, measured)
    return running.state()
