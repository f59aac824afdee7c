"""The adaptive control as a pure state machine: frame in, decision out."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from talc.explanation import Explanation, Reasons, Weights
from talc.forecast import Forecast, PlannedForecast
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
)
from talc.hold import HeldState
from talc.learner import CourseState, LearningCourse, Prior
from talc.models import ErrorModel, ModelSet
from talc.names import ERROR_UNITS, THERMAL_ERRORS
from talc.papers.phased import PhasedModels, PhasedState
from talc.record import Record
from talc.settings import TalcSettings
from talc.strategy import Strategy

_LONGEST_GAP_STEPS = 2016
"""After a longer silence the record starts again; models stay. Steps, whatever they last (a week at 5 min), because the
models, whose lags are steps, run through each of them, and the record keeps them."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ControllerState:
    """The controller's whole state, as values; `Controller.restore` continues from it as if nothing had happened."""

    input_names: tuple[str, ...]
    inputs: FloatArray
    """(T, n) filled; likewise valid (T, n) and measured (T, 9). Of the learner the last one or two rows."""
    valid: BoolArray
    measured: FloatArray
    last_k: int | None
    strategy: CourseState | PhasedState | HeldState

    @property
    def course(self) -> CourseState | None:
        """The learner's state, if the learner made it."""
        return self.strategy if isinstance(self.strategy, CourseState) else None

    @property
    def models(self) -> tuple[ErrorModel | None, ...]:
        """(9,) the live models; none but with the method `models`."""
        if not isinstance(self.strategy, PhasedState):
            return (None,) * len(THERMAL_ERRORS)
        return tuple(None if known is None else known[0] for known in self.strategy.models)

    def without_record(self) -> "ControllerState":
        """What was learnt, without the rows and without a training that is in progress."""
        strategy = self.strategy
        if isinstance(strategy, PhasedState):
            strategy = replace(strategy, learning=False, estimates={})
        return replace(
            self, inputs=self.inputs[:0], valid=self.valid[:0], measured=self.measured[:0], strategy=strategy
        )


class Controller:
    """Learns and corrects thermal errors by a strategy, which the settings name.

    `learner`: talc.learner.course.LearningCourse. `models`: talc.papers.phased.PhasedModels.

    Numbers beyond LARGEST_INPUT and LARGEST_ERROR (talc.frame) do not count as values; a decision reports a measured
    one.

    Parameters
    ----------
    input_names: order of a frame's inputs
    settings: choices
    step_s: grid step
    prior: the learner's, from other machines; None: none
    strategy: another one than the settings name, such as talc.hold.MeasureAndHold
    """

    def __init__(
        self,
        input_names: Sequence[str],
        settings: TalcSettings,
        step_s: float = 300.0,
        prior: Prior | None = None,
        strategy: Strategy | None = None,
    ) -> None:
        self._names = tuple(input_names)
        if len(set(self._names)) != len(self._names):
            raise ValueError(f"input_names = {self._names!r}: a name occurs twice")
        models = strategy is None and settings.method == "models"
        # Other strategies keep what they need of the past themselves, so that their memory does not grow with age.
        self._record = Record(len(self._names), settings.training.window_steps if models else 1)
        if strategy is not None:
            self._strategy = strategy
        elif models:
            self._strategy = PhasedModels(self._names, settings, self._record)
        else:
            self._strategy = LearningCourse(self._names, settings.learner, step_s, prior)

    @property
    def last_k(self) -> int | None:
        """The last frame's; None: there was none."""
        return self._record.last_k

    @property
    def learning(self) -> bool:
        """Whether a training was requested, and nothing has been adopted since."""
        return self._strategy.learning

    @property
    def phase(self) -> Phase:
        return self._strategy.phase

    def between(self, inputs: FloatArray, valid: BoolArray, steps: float) -> FloatArray | None:
        """(9,) the correction this many steps after the last frame, > 0, with the (n,) inputs of that moment: means
        over one step, as a frame has them. Changes nothing. None before the first frame, and with the method `models`,
        which are defined on the grid."""
        return self._strategy.between(inputs, valid, steps)

    def explain(self) -> Explanation | None:
        """Why the learner's present estimates are what they are; None with the method `models`."""
        return self._strategy.explain()

    def weights(self) -> Weights | None:
        """What the learner knows of how the errors follow the inputs; None with the method `models`."""
        return self._strategy.weights()

    def reasons(self) -> Reasons | None:
        """The same for people, with what is expected at the next measurement. Takes as long as a few steps."""
        return self._strategy.reasons()

    def forecast(self, steps: Sequence[int]) -> Forecast | None:
        """The learner's estimates for each of these numbers of steps ahead. Takes as long as a few steps."""
        return self._strategy.forecast(steps)

    def along(self, changes: FloatArray, steps: Sequence[int]) -> PlannedForecast:
        """The learner's estimates for each of these numbers of steps ahead, if the inputs differ from the last
        frame's by (T, n) at each of the next T steps. ValueError: the method has no forecasts."""
        return self._strategy.along(changes, steps)

    def state(self) -> ControllerState:
        """All that is known, copied: later steps do not change it."""
        return ControllerState(
            input_names=self._names,
            inputs=self._record.inputs.copy(),
            valid=self._record.valid.copy(),
            measured=self._record.measured.copy(),
            last_k=self._record.last_k,
            strategy=self._strategy.state(),
        )

    @classmethod
    def restore(
        cls,
        state: ControllerState,
        settings: TalcSettings,
        step_s: float = 300.0,
        prior: Prior | None = None,
        strategy: Strategy | None = None,
    ) -> "Controller":
        """A controller that decides as the one that returned `state` would have. ValueError: invalid state.

        A training in progress is not part of the state: pass its job's models to `adopt`, or run it again.
        """
        self = cls(state.input_names, settings, step_s, prior, strategy)
        is_own = isinstance(state.strategy, self._strategy.state_class)
        if not is_own:
            raise ValueError(f"method = {settings.method!r}: the state was made with the other method")
        self._record.restore(state.inputs, state.valid, state.measured, state.last_k)
        self._strategy.restore(state.strategy)
        return self

    def step(self, frame: Frame) -> Decision:
        """Take one frame. ValueError: wrong shapes, or an index that is not above the last one."""
        last = self._record.last_k
        if last is not None and frame.k <= last:
            raise ValueError(f"k = {frame.k}: expected more than {last}, the last frame's")
        if last is not None and (frame.pause_unknown or frame.k - last > _LONGEST_GAP_STEPS):
            self._record.clear()
        elif last is not None:
            for k in range(last + 1, frame.k):  # row by row: a window shorter than the gap drops rows meanwhile
                self._record.append_gap(k + 1)
                self._strategy.miss(self._record.inputs[-1])
        self._record.append(frame)
        decision = self._strategy.step(frame, self._record.measured[-1])
        if frame.measurement is None or not (impossible := _impossible(frame.measurement)):
            return decision
        return replace(decision, events=(*impossible, *decision.events))

    def adopt(self, models: ModelSet) -> tuple[Event, ...]:
        """Adopt new models; they act from the next step on. An error without a new model keeps its former one.

        ValueError: the models were trained on other inputs, or the method takes none.
        """
        return self._strategy.adopt(models)


def _impossible(measurement: Measurement) -> list[Event]:
    """Reports of the measured numbers that no machine can have."""
    events = []
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
    return events
