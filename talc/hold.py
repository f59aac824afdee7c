"""Measure-and-hold: each error is corrected by its last measurement until the next one, at a fixed interval."""

from dataclasses import dataclass

import numpy as np

from talc.frame import Decision, Event, EventCode, EventKind, FloatArray, Frame, Phase, Why
from talc.names import THERMAL_ERRORS
from talc.stage import Stage
from talc.strategy import Strategy


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeldState:
    """Everything that measure-and-hold knows."""

    phase: Phase
    held: FloatArray
    """(9,) last measurement of each error."""
    measured_in_phase: int
    last_measured: int | None


class MeasureAndHold(Strategy):
    """What any other strategy must beat. It learns nothing, and knows no uncertainty.

    Parameters
    ----------
    interval_steps: steps from one measurement to the next
    """

    method = "hold"
    state_class = HeldState

    def __init__(self, interval_steps: int) -> None:
        if interval_steps < 1:
            raise ValueError(f"interval_steps = {interval_steps}: expected 1 or more")
        self._interval = interval_steps
        self._stage = Stage()
        self._held = np.full(len(THERMAL_ERRORS), np.nan)
        self._last_measured: int | None = None

    @property
    def phase(self) -> Phase:
        return self._stage.phase

    def step(self, frame: Frame, measured: FloatArray) -> Decision:
        """Take one frame."""
        events: list[Event] = []
        before = self._held
        if frame.new_reference:
            before = self._held = np.where(np.isfinite(before), 0.0, before)
            events.append(Event(EventKind.NEW_REFERENCE, code=EventCode.NEW_REFERENCE))
        if frame.pause_unknown:
            self._last_measured = None
        if np.isfinite(measured).any():
            self._held = np.where(np.isfinite(measured), measured, before)
            self._last_measured = frame.k
            self._stage.measured += 1
            if self.phase is Phase.CALIBRATION:
                self._stage.enter(Phase.COMPENSATION, events)
        last = self._last_measured
        due = last is None or frame.k + 1 - last >= self._interval
        unknown = np.full(len(THERMAL_ERRORS), np.nan)
        return Decision(
            k=frame.k,
            phase=self.phase,
            predicted=before.copy(),
            corrected=self._held.copy(),
            sigma=unknown,
            limits=unknown.copy(),
            measure=(Why.CALIBRATION if last is None else Why.INTERVAL) if due else None,
            training=None,
            events=tuple(events),
            substituted=(),
        )

    def state(self) -> HeldState:
        """All that is known, copied."""
        return HeldState(
            phase=self.phase,
            held=self._held.copy(),
            measured_in_phase=self._stage.measured,
            last_measured=self._last_measured,
        )

    def restore(self, state: HeldState) -> None:
        """Continue from a state."""
        self._stage, self._last_measured = Stage(state.phase, state.measured_in_phase), state.last_measured
        self._held = state.held.copy()
