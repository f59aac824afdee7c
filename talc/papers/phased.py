"""The adaptive control of Z22 and B19: phases, action control limits, trainings, and models that run freely."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from talc.frame import (
    Decision,
    Event,
    EventCode,
    EventKind,
    FloatArray,
    Frame,
    Phase,
    TrainingJob,
    Why,
)
from talc.indicators import TWO_SIDED_95
from talc.models import ErrorModel, ModelSet
from talc.names import ERROR_UNITS, MICROMETRE, THERMAL_ERRORS
from talc.papers.free_running import FreeRunningModel, ModelState
from talc.record import Record
from talc.settings import TalcSettings
from talc.stage import Stage, limit_exceeded
from talc.strategy import Strategy

_ENOUGH = 0.75
"""Share of the calibration's measurements that must have arrived."""
_ERRORS = len(THERMAL_ERRORS)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PhasedState:
    """Everything that the phases know besides the record."""

    phase: Phase
    models: tuple[tuple[ErrorModel, ModelState] | None, ...]
    held: FloatArray
    """(9,) last measurement of each error."""
    learning: bool
    """A training was requested, and nothing has been adopted since."""
    measured_in_phase: int
    last_measured: int | None
    substituted: frozenset[str]
    bounded: frozenset[str]
    static: tuple[tuple[str, ...] | None, ...] | None
    estimates: Mapping[int, FloatArray] = field(default_factory=dict)
    """(9,) of the steps that a training needs; see `PhasedModels`."""


class PhasedModels(Strategy):
    """Phases, action control limits, state and model updates (Z22 §2-3, Table 2; B19 §2-3).

    `calibration` measures at every step, or every few, until enough is known for the first models. `compensation`
    predicts at every step and measures at an interval; a measurement resets the models' output history (state update).
    A residual above its limit leads to `no_good`: measurements at every step, then a training on all that is known,
    then `compensation` again. With an update interval, `compensation` also trains at fixed grid steps, whatever the
    residuals. While a training is in progress, predictions continue with the present models.

    Inputs without a good value are replaced by their last good one, or by the training's mean if there never was one; a
    decision reports when that begins and ends for an input that a model uses. A thermal error without a model is
    corrected by its last measurement once other models are live.

    For ARX models that keep their inputs, what was estimated just before a measurement is kept for the trainings, which
    take it for an output that was not measured (Z22 eq. 2); of an error without a model, its last measurement.

    Parameters
    ----------
    input_names: order of a frame's inputs
    settings: choices; `training` is passed on to the training jobs
    record: the controller's, with `training.window_steps` rows; its last row is that of the step
    """

    method = "models"
    state_class = PhasedState

    def __init__(self, input_names: Sequence[str], settings: TalcSettings, record: Record) -> None:
        self._names = tuple(input_names)
        self._control, self._training = settings.control, settings.training
        self._record = record
        self._stage = Stage()
        self._models: list[FreeRunningModel | None] = [None] * _ERRORS
        self._held = np.full(_ERRORS, np.nan)
        self._learning = False
        self._last_measured: int | None = None
        self._substituted: frozenset[str] = frozenset()
        self._bounded: frozenset[str] = frozenset()
        self._static: tuple[tuple[str, ...] | None, ...] | None = None
        self._estimates: dict[int, FloatArray] = {}

    @property
    def learning(self) -> bool:
        return self._learning

    @property
    def phase(self) -> Phase:
        return self._stage.phase

    def state(self) -> PhasedState:
        """All that is known, copied: later steps do not change it."""
        return PhasedState(
            phase=self.phase,
            models=tuple(None if m is None else (m.model, m.state()) for m in self._models),
            held=self._held.copy(),
            learning=self._learning,
            measured_in_phase=self._stage.measured,
            last_measured=self._last_measured,
            substituted=self._substituted,
            bounded=self._bounded,
            static=self._static,
            estimates={k: row.copy() for k, row in self._estimates.items()},
        )

    def restore(self, state: PhasedState) -> None:
        """Continue from a state; the record is the controller's. ValueError: invalid state.

        A training in progress is not part of the state: pass its job's models to `adopt`, or run it again.
        """
        self._stage, self._learning = Stage(state.phase, state.measured_in_phase), state.learning
        for i, known in enumerate(state.models):
            if known is not None:
                model, progress = known
                running = FreeRunningModel(model, [self._names.index(name) for name in model.inputs])
                running.restore(progress)
                self._models[i] = running
        self._held, self._last_measured, self._static = state.held.copy(), state.last_measured, state.static
        self._substituted, self._bounded = state.substituted, state.bounded
        self._estimates = {k: row.copy() for k, row in state.estimates.items()}

    def miss(self, inputs: FloatArray) -> None:
        """The models run on held inputs."""
        for model in self._models:
            if model is not None:
                model.step(inputs, float("nan"))

    def step(self, frame: Frame, measured: FloatArray) -> Decision:
        """Take one frame, which is the record's last row. ValueError: it has a new reference, and models count from the
        one of their training."""
        if frame.new_reference:
            raise ValueError(f"k = {frame.k}: a new reference; trained models count from one, the learner from several")
        events: list[Event] = []
        if frame.pause_unknown:
            self._last_measured = None
        self._note_substitutes(events)
        predicted, corrected, sigma, novel = self._predict(measured, events)
        self._note_estimates(frame.k, predicted)
        limits = self._limits()
        if np.isfinite(measured).any():
            self._last_measured = frame.k
            self._stage.measured += 1
            self._held = np.where(np.isfinite(measured), measured, self._held)
            self._judge(predicted, measured, limits, events)
        if self._stage.phase is not Phase.CALIBRATION:
            no_model = [m is None for m in self._models]
            corrected = np.where(no_model, self._held, corrected)
        training = self._job(frame.k, events)
        return Decision(
            k=frame.k,
            phase=self._stage.phase,
            predicted=predicted,
            corrected=corrected,
            sigma=sigma,
            limits=limits,
            measure=self._why_measure(frame.k, novel, sigma, limits),
            training=training,
            events=tuple(events),
            substituted=tuple(sorted(self._substituted)),
        )

    def adopt(self, models: ModelSet) -> tuple[Event, ...]:
        """Adopt new models; they act from the next step on. An error without a new model keeps its former one.

        ValueError: the models were trained on other inputs.
        """
        if models.input_names != self._names:
            raise ValueError("the models were trained on other inputs than this controller has")
        self._learning = False
        events = [Event(EventKind.MODEL_REJECTED, code=note.code, values=note.values) for note in models.notes]
        for i, model in enumerate(models.models):
            if model is None:
                continue
            columns = [self._names.index(name) for name in model.inputs]
            fresh = FreeRunningModel(model, columns)
            fresh.warm_up(self._record.inputs, self._record.measured[:, i])
            self._models[i] = fresh
            code = EventCode.MODELS_ADOPTED if model.inputs else EventCode.MODEL_WITHOUT_INPUTS
            values = {"error": model.error, "inputs": model.inputs, "na": model.na}
            events.append(
                Event(
                    EventKind.MODELS_ADOPTED,
                    error=model.error,
                    value=model.residual_std,
                    limit=model.limit,
                    code=code,
                    values=values,
                )
            )
        if self._stage.phase is Phase.NO_GOOD and models.why == Why.INTERVAL:
            return tuple(events)  # the phase began during the training, and goes on
        self._stage.measured = 0
        if all(m is None for m in self._models):
            events.append(Event(EventKind.MODEL_REJECTED, code=EventCode.NO_MODEL))
        else:
            if self._training.static_inputs:
                # The inputs of an error that had no model yet are chosen by the next training.
                before = self._static or (None,) * _ERRORS
                chosen = [None if m is None else m.model.inputs for m in self._models]
                self._static = tuple(new if old is None else old for old, new in zip(before, chosen, strict=True))
            self._stage.enter(Phase.COMPENSATION, events)
        return tuple(events)

    # Parts of a step -------------------------------------------------------------------------------------------------

    def _predict(self, measured: FloatArray, events: list[Event]) -> tuple[FloatArray, FloatArray, FloatArray, bool]:
        predicted, corrected, sigma = np.full((3, _ERRORS), np.nan)
        bounded, novel = set(), False
        for i, model in enumerate(self._models):
            if model is None:
                continue
            estimate = model.step(self._record.inputs[-1], float(measured[i]))
            predicted[i], corrected[i], sigma[i] = estimate.predicted, estimate.corrected, estimate.sigma
            novel = novel or estimate.novelty > 1.0
            if estimate.bounded:
                bounded.add(THERMAL_ERRORS[i])
        events.extend(
            Event(EventKind.PREDICTION_BOUNDED, error=error, code=EventCode.PREDICTION_BOUNDED, values={"error": error})
            for error in sorted(bounded - self._bounded)
        )
        self._bounded = frozenset(bounded)
        return predicted, corrected, sigma, novel

    def _note_estimates(self, k: int, predicted: FloatArray) -> None:
        reach = self._training.max_na if self._training.keeps_estimates else 0
        if not reach:
            return
        if np.isfinite(predicted).any():
            self._estimates[k] = np.where(np.isfinite(predicted), predicted, self._held)
        if not np.isfinite(self._record.measured[-reach:]).any():
            self._estimates.pop(k - reach, None)  # no measured row is within its reach

    def _note_substitutes(self, events: list[Event]) -> None:
        used = {name for m in self._models if m is not None for name in m.model.inputs}
        valid = self._record.valid[-1]
        missing = frozenset(name for name, ok in zip(self._names, valid, strict=True) if not ok and name in used)
        began, ended = sorted(missing - self._substituted), sorted((self._substituted - missing) & used)
        told = [(EventCode.LAST_VALUE_USED, name) for name in began]
        told += [(EventCode.VALUE_GOOD_AGAIN, name) for name in ended]
        events.extend(Event(EventKind.INPUT_SUBSTITUTED, code=code, values={"input": name}) for code, name in told)
        self._substituted = missing

    def _judge(self, predicted: FloatArray, measured: FloatArray, limits: FloatArray, events: list[Event]) -> None:
        if self._stage.phase is Phase.CALIBRATION:
            return
        events.append(Event(EventKind.STATE_UPDATE, code=EventCode.STATE_CORRECTED))
        residual = np.abs(measured - predicted)
        for i in np.flatnonzero(residual > limits):  # NaN compares false: no model, not measured
            name = THERMAL_ERRORS[i]
            events.append(limit_exceeded(name, ERROR_UNITS[name], float(residual[i]), float(limits[i])))
            if self._stage.phase is Phase.COMPENSATION:
                self._stage.enter(Phase.NO_GOOD, events)

    def _job(self, k: int, events: list[Event]) -> TrainingJob | None:
        if self._learning:
            return None
        match self._stage.phase:
            case Phase.CALIBRATION:
                steps, every = self._control.calibration_steps, self._control.calibration_interval_steps
                enough = len(self._record) >= steps and self._stage.measured >= _ENOUGH * steps / every
                why = Why.CALIBRATION
            case Phase.NO_GOOD:
                enough, why = self._stage.measured >= self._control.no_good_measurements, Why.NO_GOOD
            case Phase.COMPENSATION:
                update = self._control.update_interval_steps
                enough, why = update is not None and k % update == 0, Why.INTERVAL
        if not enough:
            return None
        self._learning = True
        values = {"n": self._stage.measured, "why": why.value}
        events.append(Event(EventKind.TRAINING_WANTED, code=EventCode.TRAINING_WANTED, values=values))
        rows = slice(-self._training.window_steps if self._training.window_steps else None, None)
        measured = self._record.measured[rows].copy()
        begin = k + 1 - len(measured)
        self._estimates = {at: row for at, row in self._estimates.items() if at >= begin}
        estimated = np.full_like(measured, np.nan)
        for at, row in self._estimates.items():
            estimated[at - begin] = row
        return TrainingJob(
            k=k,
            why=why,
            input_names=self._names,
            inputs=self._record.inputs[rows].copy(),
            valid=self._record.valid[rows].copy(),
            measured=measured,
            settings=self._training,
            static_inputs=self._static,
            estimated=estimated if self._estimates else None,
        )

    def _why_measure(self, k: int, novel: bool, sigma: FloatArray, limits: FloatArray) -> Why | None:
        since = k + 1 - self._last_measured if self._last_measured is not None else k + 1
        match self._stage.phase:
            case Phase.CALIBRATION:
                due = self._last_measured is None or since >= self._control.calibration_interval_steps
                return Why.CALIBRATION if due else None
            case Phase.NO_GOOD:
                return None if self._learning or since < self._control.no_good_interval_steps else Why.NO_GOOD
            case Phase.COMPENSATION:
                return self._routine(since, novel, sigma, limits)

    def _routine(self, since: int, novel: bool, sigma: FloatArray, limits: FloatArray) -> Why | None:
        """A routine measurement `since` steps after the last one."""
        control = self._control
        if control.policy == "fixed":
            return Why.INTERVAL if since >= control.measurement_interval_steps else None
        if since >= control.longest_interval_steps:
            return Why.INTERVAL
        if since < control.shortest_interval_steps:
            return None
        if control.policy == "novelty":
            return Why.NOVELTY if novel else None
        unsure = TWO_SIDED_95 * sigma > control.uncertainty_share * limits  # NaN compares false: no model
        return Why.UNCERTAINTY if unsure.any() else None

    def _limits(self) -> FloatArray:
        limits = np.full(_ERRORS, np.nan)
        for i, (name, model) in enumerate(zip(THERMAL_ERRORS, self._models, strict=True)):
            if model is None:
                continue
            match self._control.acl:
                case "fixed":
                    position = ERROR_UNITS[name] == MICROMETRE
                    limits[i] = self._control.acl_fixed_um if position else self._control.acl_fixed_um_per_m
                case "training":
                    limits[i] = model.model.training_limit
                case "adaptive":
                    limits[i] = model.model.limit
        return limits
