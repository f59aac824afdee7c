"""The adaptive control of Z22 and B19 as a pure state machine: frame in, decision out."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from talc.frame import (
    LARGEST_ERROR,
    BoolArray,
    Decision,
    Event,
    EventCode,
    EventKind,
    FloatArray,
    Frame,
    Measurement,
    Phase,
    TrainingJob,
    Why,
)
from talc.free_running import FreeRunningModel, ModelState
from talc.indicators import TWO_SIDED_95
from talc.learner import CourseState, Explanation, Forecast, LearningCourse, PlannedForecast, Prior, Reasons, Weights
from talc.models import ErrorModel, ModelSet
from talc.names import ERROR_UNITS, MICROMETRE, THERMAL_ERRORS
from talc.record import Record
from talc.settings import TalcSettings
from talc.stage import Stage, limit_exceeded

_ENOUGH = 0.75
"""Share of the calibration's measurements that must have arrived."""
_LONGEST_GAP_STEPS = 2016
"""After a longer silence the record starts again; models stay. Steps, whatever they last (a week at 5 min), because the
models, whose lags are steps, run through each of them, and the record keeps them."""
_ERRORS = len(THERMAL_ERRORS)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ControllerState:
    """The controller's whole state, as values; `Controller.restore` continues from it as if nothing had happened."""

    input_names: tuple[str, ...]
    inputs: FloatArray
    """(T, n) filled; likewise valid (T, n) and measured (T, 9). Of the learner the last one or two rows."""
    valid: BoolArray
    measured: FloatArray
    last_k: int | None
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
    course: CourseState | None = None
    """The learner's state; the fields from `models` on are then those of a controller without models."""


class Controller:
    """Learns and corrects thermal errors by the method that the settings name.

    `learner`: talc.learner.course.LearningCourse. It requests no training and takes no models.

    `models`: phases, action control limits, state and model updates (Z22 §2-3, Table 2; B19 §2-3).

    `calibration` measures at every step, or every few, until enough is known for the first models. `compensation`
    predicts at every step and measures at an interval; a measurement resets the models' output history (state update).
    A residual above its limit leads to `no_good`: measurements at every step, then a training on all that is known,
    then `compensation` again. While a training is in progress, predictions continue with the present models.

    Inputs without a good value are replaced by their last good one, or by the training's mean if there never was one; a
    decision reports when that begins and ends for an input that a model uses. Numbers beyond LARGEST_INPUT and
    LARGEST_ERROR (talc.frame) do not count as values; a decision reports a measured one. A thermal error without a
    model is corrected by its last measurement once other models are live.

    Parameters
    ----------
    input_names: order of a frame's inputs
    settings: choices; `training` is passed on to the training jobs
    step_s: grid step
    prior: the learner's, from other machines; None: none
    """

    def __init__(
        self, input_names: Sequence[str], settings: TalcSettings, step_s: float = 300.0, prior: Prior | None = None
    ) -> None:
        self._names = tuple(input_names)
        if len(set(self._names)) != len(self._names):
            raise ValueError(f"input_names = {self._names!r}: a name occurs twice")
        self._control, self._training = settings.control, settings.training
        # The learner keeps what it needs of the past itself, so that its memory does not grow with age.
        self._record = Record(len(self._names), 1 if settings.method == "learner" else settings.training.window_steps)
        self._stage = Stage()
        self._models: list[FreeRunningModel | None] = [None] * _ERRORS
        self._held = np.full(_ERRORS, np.nan)
        self._learning = False
        self._last_measured: int | None = None
        self._substituted: frozenset[str] = frozenset()
        self._bounded: frozenset[str] = frozenset()
        self._static: tuple[tuple[str, ...] | None, ...] | None = None
        self._course: LearningCourse | None = None
        if settings.method == "learner":
            self._course = LearningCourse(self._names, settings.learner, step_s, prior)

    @property
    def learning(self) -> bool:
        """Whether a training was requested, and nothing has been adopted since."""
        return self._learning

    @property
    def phase(self) -> Phase:
        return self._stage.phase if self._course is None else self._course.phase

    def between(self, inputs: FloatArray, valid: BoolArray, steps: float) -> FloatArray | None:
        """(9,) the learner's correction this many steps after the last frame, > 0, with the (n,) inputs of that moment:
        means over one step, as a frame has them. Changes nothing. None before the first frame, and with the method
        `models`, which are defined on the grid."""
        return None if self._course is None else self._course.between(inputs, valid, steps)

    def explain(self) -> Explanation | None:
        """Why the learner's present estimates are what they are; None with the method `models`."""
        return None if self._course is None else self._course.explain()

    def weights(self) -> Weights | None:
        """What the learner knows of how the errors follow the inputs; None with the method `models`."""
        return None if self._course is None else self._course.weights()

    def reasons(self) -> Reasons | None:
        """The same for people, with what is expected at the next measurement. Takes as long as a few steps."""
        return None if self._course is None else self._course.reasons()

    def forecast(self, steps: Sequence[int]) -> Forecast | None:
        """The learner's estimates for each of these numbers of steps ahead. Takes as long as a few steps."""
        return None if self._course is None else self._course.forecast(steps)

    def along(self, changes: FloatArray, steps: Sequence[int]) -> PlannedForecast:
        """The learner's estimates for each of these numbers of steps ahead, if the inputs differ from the last
        frame's by (T, n) at each of the next T steps. ValueError: the method has no forecasts."""
        if self._course is None:
            raise ValueError("the method models makes no forecasts")
        return self._course.along(changes, steps)

    def state(self) -> ControllerState:
        """All that is known, copied: later steps do not change it."""
        return ControllerState(
            input_names=self._names,
            inputs=self._record.inputs.copy(),
            valid=self._record.valid.copy(),
            measured=self._record.measured.copy(),
            last_k=self._record.last_k,
            phase=self.phase,
            models=tuple(None if m is None else (m.model, m.state()) for m in self._models),
            held=self._held.copy(),
            learning=self._learning,
            measured_in_phase=self._stage.measured,
            last_measured=self._last_measured,
            substituted=self._substituted,
            bounded=self._bounded,
            static=self._static,
            course=None if self._course is None else self._course.state(),
        )

    @classmethod
    def restore(
        cls, state: ControllerState, settings: TalcSettings, step_s: float = 300.0, prior: Prior | None = None
    ) -> "Controller":
        """A controller that decides as the one that returned `state` would have. ValueError: invalid state.

        A training in progress is not part of the state: pass its job's models to `adopt`, or run it again.
        """
        self = cls(state.input_names, settings, step_s, prior)
        if (self._course is None) != (state.course is None):
            raise ValueError(f"method = {settings.method!r}: the state was made with the other method")
        if self._course is not None and state.course is not None:
            self._course.restore(state.course)
        self._record.restore(state.inputs, state.valid, state.measured, state.last_k)
        self._stage, self._learning = Stage(state.phase, state.measured_in_phase), state.learning
        for i, known in enumerate(state.models):
            if known is not None:
                model, progress = known
                running = FreeRunningModel(model, [self._names.index(name) for name in model.inputs])
                running.restore(progress)
                self._models[i] = running
        self._held, self._last_measured, self._static = state.held.copy(), state.last_measured, state.static
        self._substituted, self._bounded = state.substituted, state.bounded
        return self

    def step(self, frame: Frame) -> Decision:
        """Take one frame. ValueError: wrong shapes, or an index that is not above the last one."""
        last = self._record.last_k
        if last is not None and frame.k <= last:
            raise ValueError(f"k = {frame.k}: expected more than {last}, the last frame's")
        if last is not None and (frame.pause_unknown or frame.k - last > _LONGEST_GAP_STEPS):
            self._record.clear()
        elif last is not None and frame.k > last + 1:
            self._bridge(frame.k)
        self._record.append(frame)
        if frame.pause_unknown:
            self._last_measured = None
        events: list[Event] = []
        if frame.measurement is not None:
            _note_impossible(frame.measurement, events)
        if self._course is not None:
            decision = self._course.step(frame, self._record.measured[-1])
            return replace(decision, events=(*events, *decision.events)) if events else decision
        self._note_substitutes(events)
        measured = self._record.measured[-1]
        predicted, corrected, sigma, novel = self._predict(measured, events)
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
        if self._course is not None:
            raise ValueError("method = 'learner': it takes no models")
        if models.input_names != self._names:
            raise ValueError("the models were trained on other inputs than this controller has")
        self._learning = False
        events = [
            Event(EventKind.MODEL_REJECTED, code=EventCode.TRAINING_NOTE, values={"note": note})
            for note in models.notes
        ]
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

    def _bridge(self, until_k: int) -> None:
        """Let the models run, on held inputs, through steps without a frame."""
        last = self._record.last_k
        if last is None:
            return
        for k in range(last + 1, until_k):  # row by row: a window shorter than the gap drops rows meanwhile
            self._record.append_gap(k + 1)
            for model in self._models:
                if model is not None:
                    model.step(self._record.inputs[-1], float("nan"))

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
                return None
        if not enough:
            return None
        self._learning = True
        values = {"n": self._stage.measured, "why": why.value}
        events.append(Event(EventKind.TRAINING_WANTED, code=EventCode.TRAINING_WANTED, values=values))
        rows = slice(-self._training.window_steps if self._training.window_steps else None, None)
        return TrainingJob(
            k=k,
            why=why,
            input_names=self._names,
            inputs=self._record.inputs[rows].copy(),
            valid=self._record.valid[rows].copy(),
            measured=self._record.measured[rows].copy(),
            settings=self._training,
            static_inputs=self._static,
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


def _note_impossible(measurement: Measurement, events: list[Event]) -> None:
    for i in np.flatnonzero(np.abs(measurement.errors) > LARGEST_ERROR):
        name = THERMAL_ERRORS[i]
        values = {"error": name, "value": float(measurement.errors[i]), "unit": ERROR_UNITS[name]}
        events.append(
            Event(
                EventKind.MEASUREMENT_REJECTED,
                error=name,
                limit=LARGEST_ERROR,
                code=EventCode.IMPOSSIBLE,
                values=values,
            )
        )
