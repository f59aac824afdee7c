"""The control loop around the learner: what to correct, when to measure, what to report."""

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from talc.explanation import Explanation, Reasons, Weights
from talc.forecast import Forecast, PlannedForecast
from talc.frame import (
    LARGEST_INPUT,
    BoolArray,
    Decision,
    Event,
    EventCode,
    EventKind,
    FloatArray,
    Frame,
    Phase,
    Why,
)
from talc.indicators import TWO_SIDED_95
from talc.learner.experts import EXPERTS, OTHERS_EXPERTS
from talc.learner.learner import Estimate, LearnerState, RowLearner
from talc.learner.plausible import InputFault
from talc.learner.prior import Prior
from talc.learner.reasons import reasons_for
from talc.learner.told import Surprise
from talc.names import ERROR_UNITS, MICROMETRE, THERMAL_ERRORS
from talc.settings import LearnerSettings
from talc.stage import Stage, limit_exceeded
from talc.strategy import Strategy

_SETTLED_S = 3600.0
"""After a gap longer than this a measurement is wanted at once."""
_UNKNOWN_PAUSE_S = 30 * 86400.0
"""A pause of unknown length counts as this long, unless it was longer."""


@dataclass(frozen=True, slots=True, eq=False)
class CourseState:
    """Everything that a course knows besides the record."""

    learner: LearnerState
    phase: Phase
    last_k: int | None
    last_measured: int | None
    wanted: Why | None
    measured_in_phase: int
    trusted: BoolArray
    substituted: frozenset[str]
    tolerance_um: float = 0.0
    """The latest that was stated; 0: none."""


class LearningCourse(Strategy):
    """Compensation from the first measurement on; the learner learns at every one.

    An error is corrected while its estimate is better than no correction (`Decision.trusted`). A measurement is wanted
    when the 95 % interval of a trusted error, or of one that may become so, leaves the declared limit; after a gap;
    after a measurement that was far from its prediction; and at the latest after the longest interval.

    Parameters
    ----------
    input_names: order of a frame's inputs
    settings: limits and intervals
    step_s: grid step
    prior: what other machines have learnt; None: nothing
    errors: names; the nine, as in the shapes below, or any others, which are in µm and for which there is no prior
    """

    method = "learner"
    state_class = CourseState

    def __init__(
        self,
        input_names: Sequence[str],
        settings: LearnerSettings,
        step_s: float,
        prior: Prior | None = None,
        errors: Sequence[str] = THERMAL_ERRORS,
    ) -> None:
        self._names, self._settings, self._errors = tuple(input_names), settings, tuple(errors)
        if prior is not None and self._errors != THERMAL_ERRORS:
            raise ValueError(f"errors = {', '.join(errors)}: a prior is of {', '.join(THERMAL_ERRORS)}")
        self._units = tuple(ERROR_UNITS.get(name, MICROMETRE) for name in self._errors)
        positions = np.array([unit == MICROMETRE for unit in self._units])
        self._limits = self._declared = np.where(positions, settings.limit_um, settings.limit_um_per_m)
        self._tolerance_um = 0.0
        noise = np.where(positions, settings.noise_um, settings.noise_um_per_m)
        self._learner = RowLearner(len(self._names), step_s, noise, None if prior is None else prior.of(self._names))
        self._experts = EXPERTS if prior is None else (*EXPERTS, *OTHERS_EXPERTS)
        self._step_s = step_s
        self._long_gap, self._unknown_gap = round(_SETTLED_S / step_s), round(_UNKNOWN_PAUSE_S / step_s)
        self._stage = Stage()
        self._last_k: int | None = None
        self._last_measured: int | None = None
        self._wanted: Why | None = None
        """Set after a gap or a surprise until the next measurement."""
        self._trusted = np.zeros(len(self._errors), dtype=np.bool_)
        self._substituted: frozenset[str] = frozenset()

    @property
    def phase(self) -> Phase:
        return self._stage.phase

    def step(self, frame: Frame, measured: FloatArray) -> Decision:
        """Take one frame; measured: (9,) its errors without impossible ones."""
        events: list[Event] = []
        valid = frame.valid & (np.abs(frame.inputs) <= LARGEST_INPUT)  # NaN compares false
        gap = 0 if self._last_k is None else frame.k - self._last_k - 1
        if frame.pause_unknown:
            if self._last_measured is not None:
                self._last_measured -= max(0, self._unknown_gap - gap)
            gap = max(gap, self._unknown_gap)
        moved = self._learner.advance(np.where(valid, frame.inputs, 0.0), valid, gap)
        self._note_inputs(valid, moved, frame.inputs, events)
        if gap > self._long_gap:
            self._wanted = Why.NOVELTY
        if frame.new_reference:
            self._learner.new_reference()
            events.append(Event(EventKind.NEW_REFERENCE, code=EventCode.NEW_REFERENCE))
        self._last_k = frame.k
        self._note_tolerance(frame.tolerance_um, events)
        before = self._learner.estimate()
        after, surprise = before, None
        if np.isfinite(measured).any():
            sigma = np.full(len(self._errors), np.nan) if frame.measurement is None else frame.measurement.sigma
            surprise = self._learner.learn(measured, sigma)
            after = self._learner.estimate()
            self._last_measured, self._wanted = frame.k, None
            self._stage.measured += 1
            self._judge(before, measured, surprise, events)
        self._note_trust(after.trusted, events)
        return Decision(
            k=frame.k,
            phase=self._stage.phase,
            predicted=before.value,
            corrected=after.value,
            sigma=after.sigma,
            limits=self._limits.copy(),
            measure=self._why_measure(frame.k, after),
            training=None,
            events=tuple(events),
            substituted=tuple(sorted(self._substituted)),
            trusted=after.trusted,
        )

    def between(self, inputs: FloatArray, valid: BoolArray, steps: float) -> FloatArray | None:
        """(9,) the correction this many steps after the last frame, > 0, with the (n,) inputs of that moment; NaN as in
        `Decision.corrected`. None before the first frame. Changes nothing."""
        if self._last_k is None:
            return None
        good = valid & (np.abs(inputs) <= LARGEST_INPUT)  # NaN compares false
        return self._learner.between(np.where(good, inputs, 0.0), good, steps)

    def explain(self) -> Explanation:
        """Why the present estimates are what they are."""
        return self._learner.explain()

    def weights(self) -> Weights:
        """What is known of how the errors follow the inputs."""
        return self._learner.weights()

    def reasons(self) -> Reasons | None:
        """Why the present estimates are what they are, and what is expected next; None before the first frame."""
        if self._last_k is None:
            return None
        next_k, why = self._next(self._last_k)
        now, then = self._learner.estimate(), self._learner.estimate(next_k - self._last_k)
        errors = reasons_for(self._errors, self._names, self._experts, now, then, self._learner.explain())
        return Reasons(self._last_k, next_k, why, errors)

    def forecast(self, steps: Sequence[int]) -> Forecast | None:
        """The estimates for each of these numbers of steps ahead; None before the first frame."""
        if self._last_k is None:
            return None
        stays, measured_sigma, usual = self._learner.forecast(steps)
        return Forecast(
            k=self._last_k,
            steps=tuple(steps),
            ahead_s=tuple(ahead * self._step_s for ahead in steps),
            value=np.stack([each.value for each in stays]),
            sigma=np.stack([each.sigma for each in stays]),
            measured_sigma=measured_sigma,
            usual_value=np.stack([each.value for each in usual]),
            usual_sigma=np.stack([each.sigma for each in usual]),
        )

    def along(self, changes: FloatArray, steps: Sequence[int]) -> PlannedForecast:
        """The estimates for each of these numbers of steps ahead, if the inputs differ from now by (T, n) at each
        of the next T steps."""
        found = self._learner.along(changes, steps)
        return PlannedForecast(np.stack([e.value for e in found]), np.stack([e.sigma for e in found]))

    def state(self) -> CourseState:
        """A copy of everything that is known."""
        return CourseState(
            learner=self._learner.state(),
            phase=self._stage.phase,
            last_k=self._last_k,
            last_measured=self._last_measured,
            wanted=self._wanted,
            measured_in_phase=self._stage.measured,
            trusted=self._trusted.copy(),
            substituted=self._substituted,
            tolerance_um=self._tolerance_um,
        )

    def restore(self, state: CourseState) -> None:
        """Continue from a state. ValueError: it has other inputs."""
        self._learner.restore(state.learner)
        self._stage, self._wanted = Stage(state.phase, state.measured_in_phase), state.wanted
        self._last_k, self._last_measured = state.last_k, state.last_measured
        self._trusted, self._substituted = state.trusted.copy(), state.substituted
        self._follow(state.tolerance_um)

    # Parts of a step -------------------------------------------------------------------------------------------------

    def _note_tolerance(self, stated: float | None, events: list[Event]) -> None:
        """Let the limits follow what is stated; NaN counts as not stated again."""
        if stated is None or self._settings.least_limit_um is None or not 0.0 <= stated < np.inf:
            return
        if stated != self._tolerance_um:
            limit = self._follow(stated)
            values = {"tolerance": stated, "limit": limit, "unit": MICROMETRE}
            kind, code = EventKind.TOLERANCE_STATED, EventCode.TOLERANCE
            events.append(Event(kind, value=stated, limit=limit, code=code, values=values))

    def _follow(self, tolerance_um: float) -> float:
        """From now on by this tolerance; returns the limit of positions."""
        s, self._tolerance_um = self._settings, tolerance_um
        if tolerance_um == 0.0 or s.least_limit_um is None or s.most_limit_um is None:
            self._limits = self._declared
            return s.limit_um
        limit = min(max(tolerance_um, s.least_limit_um), s.most_limit_um)
        self._limits = self._declared * (limit / s.limit_um)
        return limit

    def _note_inputs(self, valid: BoolArray, moved: BoolArray, inputs: FloatArray, events: list[Event]) -> None:
        for found in self._learner.suspicions:
            exchanged = found.fault is InputFault.EXCHANGED
            code = EventCode.INPUTS_EXCHANGED if exchanged else EventCode.VALUE_IMPLAUSIBLE
            events.append(Event(EventKind.INPUT_SUBSTITUTED, code=code, values=found.told(self._names, inputs)))
        doubted = self._learner.doubted & valid
        missing = frozenset(name for name, ok in zip(self._names, valid & ~doubted, strict=True) if not ok)
        without = frozenset(name for name, ok in zip(self._names, valid, strict=True) if not ok)
        told = [(EventCode.VALUE_ESTIMATED, name) for name in sorted(without - self._substituted)]
        for name in sorted(self._substituted - missing):
            far = moved[self._names.index(name)]
            told.append((EventCode.VALUE_GOOD_BUT_FAR if far else EventCode.VALUE_GOOD_AGAIN, name))
        events.extend(Event(EventKind.INPUT_SUBSTITUTED, code=code, values={"input": name}) for code, name in told)
        self._substituted = missing

    def _judge(self, before: Estimate, measured: FloatArray, surprise: Surprise, events: list[Event]) -> None:
        if self._stage.phase is Phase.CALIBRATION:
            self._stage.enter(Phase.COMPENSATION, events)
        else:
            events.append(Event(EventKind.STATE_UPDATE, code=EventCode.LEARNT))
        residual = np.abs(measured - before.value)
        exceeded = residual > self._limits  # NaN compares false: not measured, or for the first time
        events.extend(
            limit_exceeded(self._errors[i], self._units[i], float(residual[i]), float(self._limits[i]))
            for i in np.flatnonzero(exceeded)
        )
        for i in np.flatnonzero(surprise.forgotten).tolist():
            n = int(surprise.forgotten[i])
            self._reject(i, EventCode.TAKEN_BACK, {"error": self._errors[i], "n": n}, events)
        for i, fault in surprise.faults.items():
            values = {"error": self._errors[i], "value": float(measured[i]), "unit": self._units[i]}
            self._reject(i, EventCode.NO_MEASUREMENT, values | {"measurement_fault": fault.value}, events)
            self._wanted = Why.RETRY
        for i in np.flatnonzero(surprise.outlier).tolist():
            name = self._errors[i]
            values = {
                "error": name,
                "value": float(measured[i]),
                "unit": self._units[i],
                "n": float(abs(surprise.ratio[i])),
            }
            self._reject(i, EventCode.OUTLIER, values, events)
            self._wanted = Why.RETRY
        if self._stage.phase is Phase.NO_GOOD:
            if self._stage.measured >= self._settings.no_good_measurements:
                self._stage.enter(Phase.COMPENSATION, events, measured=1)  # unlike after the reference, much is known
        elif exceeded.any() and self._settings.no_good_measurements:
            self._stage.enter(Phase.NO_GOOD, events)

    def _reject(self, i: int, code: EventCode, values: dict[str, object], events: list[Event]) -> None:
        events.append(Event(EventKind.MEASUREMENT_REJECTED, error=self._errors[i], code=code, values=values))

    def _note_trust(self, trusted: BoolArray, events: list[Event]) -> None:
        for i in np.flatnonzero(trusted != self._trusted):
            name = self._errors[i]
            code = EventCode.TRUSTED if trusted[i] else EventCode.NOT_TRUSTED
            events.append(Event(EventKind.TRUST_CHANGED, error=name, code=code, values={"error": name}))
        self._trusted = trusted

    def _why_measure(self, k: int, after: Estimate) -> Why | None:
        s = self._settings
        if self._last_measured is None:
            return Why.CALIBRATION
        since = k + 1 - self._last_measured
        if self._stage.phase is Phase.NO_GOOD:
            return Why.NO_GOOD
        if s.policy == "fixed":
            return Why.INTERVAL if since >= s.measurement_interval_steps else None
        if since < self._shortest_interval():
            return None
        if self._wanted is not None:
            return self._wanted
        if since >= s.longest_interval_steps:
            return Why.INTERVAL
        return Why.UNCERTAINTY if self._unsure(after) else None

    def _shortest_interval(self) -> int:
        """From the reference alone nothing has been learnt, so the next measurement is not held back."""
        return self._settings.shortest_interval_steps if self._stage.measured else 1

    def _unsure(self, estimate: Estimate) -> bool:
        return bool((TWO_SIDED_95 * estimate.sigma > self._limits).any())

    def _next(self, k: int) -> tuple[int, Why]:
        """When `_why_measure` will have led to a measurement, if the inputs stay as they are."""
        s = self._settings
        if self._last_measured is None:
            return k + 1, Why.CALIBRATION
        if self._stage.phase is Phase.NO_GOOD:
            return k + 1, Why.NO_GOOD
        if s.policy == "fixed":
            return max(k + 1, self._last_measured + s.measurement_interval_steps), Why.INTERVAL
        first = max(k + 1, self._last_measured + self._shortest_interval())
        if self._wanted is not None:
            return first, self._wanted
        last = max(first, self._last_measured + s.longest_interval_steps)
        if not self._unsure(self._learner.estimate(last - 1 - k)):
            return last, Why.INTERVAL
        at = bisect_left(range(first, last), 1, key=lambda m: int(self._unsure(self._learner.estimate(m - 1 - k))))
        return first + at, Why.UNCERTAINTY
