"""Training: a job in, the models of the nine thermal errors out. Deterministic for a given job and machine."""

from dataclasses import dataclass
from functools import cache
from itertools import combinations

import numpy as np

from talc.disturbance import Disturbance, disturbance_of
from talc.frame import LEAST_VALID, BoolArray, FloatArray, TrainingJob
from talc.kinds import EventCode
from talc.models import ErrorModel, ModelSet, TrainingNote
from talc.names import THERMAL_ERRORS
from talc.papers import tck
from talc.papers.routes import Fitted, Shared, by_arx, by_search
from talc.papers.search import BLOCKS
from talc.papers.window import Window
from talc.settings import TrainingSettings

__all__ = ["train"]

_POLES = (0.7, 0.88, 0.95, 0.98)
"""Of one step, whatever it lasts, as in the papers. At 5 min, time constants of 14 min, 39 min, 97 min and 4 h."""
_LEAST_ROWS = 24
_LEAST_SPREAD = 1e-6
_LEAST_OUTPUT_SPREAD = 1e-3


def train(job: TrainingJob) -> ModelSet:
    """Models of the nine errors.

    Inputs with fewer than 80 % good rows, or that never changed, are not offered. A missing value is replaced by the
    last good one; before the first good one, by that one (talc.record). With the selector `search` each error gets an
    output-error model: the poles, inputs and orders that best predict blocks of rows which the fit has not seen
    (talc.papers.search). With `pso` or `tck` it gets an ARX model as in the papers. An error with fewer than 24
    measured rows gets no model, nor does one whose model would be unstable.
    """
    run = _Training(job)
    models: list[ErrorModel | None] = []
    notes = list(run.notes)
    for error in THERMAL_ERRORS:
        try:
            models.append(run.model(error))
        except _NoModel as reason:
            models.append(None)
            notes.append(reason.note)
    return ModelSet(k=job.k, why=job.why.value, input_names=job.input_names, models=tuple(models), notes=tuple(notes))


class _NoModel(Exception):
    """An error gets no model.

    note: says why
    """

    def __init__(self, code: EventCode, **values: object) -> None:
        self.note = TrainingNote(code, values)
        super().__init__(self.note)


class _Training:
    """One training: the inputs on offer, each error's measurements, and what errors share."""

    def __init__(self, job: TrainingJob) -> None:
        self._job = job
        self._offer, self.notes = _offered(job)
        self._records = {error: _record(job, e) for e, error in enumerate(THERMAL_ERRORS)}
        self._shared: dict[bytes, Shared] = {}
        # All errors use the same sensors, and only when inputs are to be chosen.
        self._sensors = cache(lambda: tck.Ensemble(tck.offered(self._offer.scaled), seed=job.settings.seed))

    def model(self, error: str) -> ErrorModel:
        """The model of one thermal error. Raises _NoModel."""
        record, offer = self._records[error], self._offer
        if record.rows.sum() < _LEAST_ROWS or not offer.names:
            rows, inputs = int(record.rows.sum()), len(offer.names)
            raise _NoModel(EventCode.TOO_LITTLE_MEASURED, error=error, rows=rows, inputs=inputs)
        fixed = self._kept(error)
        found = self._searched(error, fixed) if self._job.settings.selector == "search" else self._arx(error, fixed)
        return _model(error, record, found, offer)

    def _kept(self, error: str) -> tuple[int, ...] | None:
        """Positions among the offered inputs that the model must use; None: choose."""
        if self._job.static_inputs is None:
            return None
        keep, names = self._job.static_inputs[THERMAL_ERRORS.index(error)], self._offer.names
        return None if keep is None else tuple(sorted(names.index(name) for name in keep if name in names))

    def _searched(self, error: str, fixed: tuple[int, ...] | None) -> Fitted:
        return by_search(self._measured_with(error), error, fixed, self._job.settings)

    def _measured_with(self, error: str) -> Shared:
        """The regressions of all errors that were measured at the same steps as this one, made once."""
        rows = self._records[error].rows
        key = rows.tobytes()
        if key not in self._shared:
            same = {name: r.scaled for name, r in self._records.items() if r.rows.tobytes() == key}
            sets, lags = _pole_sets(self._job.settings), 1 + self._job.settings.max_nb
            self._shared[key] = Shared(self._offer.scaled, rows, same, sets, lags)
        return self._shared[key]

    def _arx(self, error: str, fixed: tuple[int, ...] | None) -> Fitted:
        record, settings, past = self._records[error], self._job.settings, self._records[error].scaled
        if self._job.estimated is not None and fixed is not None:
            estimated = self._job.estimated[:, THERMAL_ERRORS.index(error)]
            past = np.where(record.rows, past, (estimated - record.mean) / record.std)
        try:
            window = Window(self._offer.scaled, record.scaled, past, record.std)
            return by_arx(window, fixed, error, settings, self._sensors)
        except (ValueError, RuntimeError) as problem:
            raise _NoModel(EventCode.NOT_FITTED, error=error, why=str(problem)) from problem


@dataclass(frozen=True, slots=True)
class _Offer:
    """The inputs a model may use, in physical units and scaled (Z22 eq. 1)."""

    names: tuple[str, ...]
    inputs: FloatArray
    """(T, n)"""
    mean: FloatArray
    std: FloatArray

    @property
    def scaled(self) -> FloatArray:
        return (self.inputs - self.mean) / self.std


@dataclass(frozen=True, slots=True)
class _ErrorRecord:
    """One error's measurements."""

    measured: FloatArray
    """(T,) NaN where there is none."""
    rows: BoolArray
    """(T,) where there is one."""
    mean: float
    std: float

    @property
    def scaled(self) -> FloatArray:
        return (self.measured - self.mean) / self.std


def _record(job: TrainingJob, e: int) -> _ErrorRecord:
    measured: FloatArray = np.where(np.isfinite(job.measured[:, e]), job.measured[:, e], np.nan)
    rows: BoolArray = np.isfinite(measured)
    known = measured[rows] if rows.any() else np.zeros(1)
    return _ErrorRecord(measured, rows, float(known.mean()), max(float(known.std()), _LEAST_OUTPUT_SPREAD))


def _pole_sets(settings: TrainingSettings) -> list[tuple[float, ...]]:
    allowed = [p for p in _POLES if p < settings.max_pole]
    return [poles for count in range(settings.max_na + 1) for poles in combinations(allowed, count)]


def _offered(job: TrainingJob) -> tuple[_Offer, list[TrainingNote]]:
    columns, notes = [], []
    # If the inputs of all errors are kept, only those cost anything.
    every = job.input_names
    kept = {name for names in job.static_inputs or () for name in (every if names is None else names)} or set(every)
    for i, name in enumerate(job.input_names):
        if name not in kept:
            continue
        share = float(job.valid[:, i].mean())
        if share < LEAST_VALID:
            values = {"input": name, "share": share, "least": LEAST_VALID}
            notes.append(TrainingNote(EventCode.INPUT_SELDOM_GOOD, values))
        elif not np.isfinite(job.inputs[:, i]).all():
            notes.append(TrainingNote(EventCode.INPUT_NOT_FILLED, {"input": name}))
        elif job.inputs[:, i].std() > _LEAST_SPREAD:
            columns.append(i)
    inputs = job.inputs[:, columns]
    names = tuple(job.input_names[i] for i in columns)
    return _Offer(names, inputs, inputs.mean(axis=0), inputs.std(axis=0)), notes


def _model(error: str, record: _ErrorRecord, found: Fitted, offer: _Offer) -> ErrorModel:
    steps = np.flatnonzero(record.rows)
    measured, y_std = record.measured[steps], record.std
    chosen = list(found.inputs)
    rows = offer.inputs[:, chosen]
    reach, swing = np.ptp(rows, axis=0), max(float(np.ptp(measured)), y_std)
    return ErrorModel(
        error=error,
        inputs=tuple(offer.names[i] for i in chosen),
        a=found.parameters.a,
        b=found.parameters.b,
        intercept=found.parameters.intercept,
        u_mean=offer.mean[chosen],
        u_std=offer.std[chosen],
        y_mean=record.mean,
        y_std=y_std,
        u_low=rows.min(axis=0) - reach,
        u_high=rows.max(axis=0) + reach,
        y_low=float(measured.min()) - swing,
        y_high=float(measured.max()) + swing,
        limit=float(np.abs(found.unseen).max()) * y_std,
        training_limit=float(np.abs(found.residual).max()) * y_std,
        residual_std=float(np.sqrt(np.mean(found.residual**2))) * y_std,
        criterion=found.criterion,
        disturbance=Disturbance()
        if found.resets_history
        else disturbance_of(found.unseen * y_std, steps[-found.unseen.size :]),
        leverage=found.leverage,
        leverage_limit=found.leverage_limit,
        novelty_std=float(np.sqrt(np.mean(found.unseen**2) / BLOCKS)) * y_std,
        resets_history=found.resets_history,
    )
