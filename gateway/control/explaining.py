"""Explanations of the controller's decisions: reasons each hour and after measurements, forecasts each step."""

import math
from collections.abc import Callable, Mapping

from gateway.model.events import ForecastMade, ReasonsGiven, Sink
from gateway.runtime.clocks import ServiceClock
from talc.control import Controller
from talc.forecast import ForecastRecord
from talc.frame import Decision, FloatArray, Frame

_EXPLAIN_EVERY_S = 3599.0
"""An hour, less a margin for the ends of steps."""
_AHEAD_S = (1800.0, 3600.0, 7200.0, 10800.0, 14400.0, 21600.0, 28800.0)
"""How far the forecasts reach."""


class Explanations:
    """Publishes them.

    Parameters
    ----------
    controller: has made the decisions
    step_s: of the grid
    sink: receives reasons and forecasts
    planned: by planned load, how the inputs (steps, n) will differ from the last frame's at each of these
        steps; None: unknown
    """

    def __init__(
        self,
        controller: Controller,
        step_s: float,
        clock: ServiceClock,
        sink: Sink,
        planned: Callable[[int], Mapping[str, FloatArray | None]] = lambda _: {},
    ) -> None:
        self._controller, self._clock, self._sink, self._planned = controller, clock, sink, planned
        ahead = {max(1, round(ahead_s / step_s)) for ahead_s in _AHEAD_S}
        self._forecasts = ForecastRecord(tuple(sorted(ahead)), step_s)
        self._reasons_s = -math.inf
        """When the reasons are due, if no measurement comes before."""

    def follow(self, frame: Frame, decision: Decision) -> None:
        """Publish what can be said of the decision that was just made on this frame."""
        measured = frame.measurement is not None
        if measured or self._clock.monotonic() >= self._reasons_s:
            self._reasons_s = self._clock.monotonic() + _EXPLAIN_EVERY_S
            if (reasons := self._controller.reasons()) is not None:
                self._sink(ReasonsGiven(reasons))
        steps = self._forecasts.steps
        if (forecast := self._controller.forecast(steps)) is not None:
            misses = self._forecasts.take(forecast, decision.corrected, decision.sigma, measured=measured)
            planned = {
                name: None if changes is None else self._controller.along(changes, steps)
                for name, changes in self._planned(steps[-1]).items()
            }
            self._sink(ForecastMade(forecast, misses, planned))
