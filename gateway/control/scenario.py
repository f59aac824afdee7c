"""The next two hours under a load that somebody thinks of: from the present models, when it is asked for."""

from datetime import datetime
from typing import Final

from gateway.control.planned_loads import PlannedLoads
from gateway.telemetry.answers import ScenarioPage
from gateway.telemetry.numbers import courses
from gateway.telemetry.scenario_queries import ScenarioRequest
from talc.control import Controller
from talc.forecast import Forecast
from talc.steps import steps_in

_EVERY_S: Final = 300.0
_UNTIL_S: Final = 7200.0


class Scenarios:
    """Answers what would become of the estimates.

    Parameters
    ----------
    controller: has made the decisions
    loads: how the inputs follow loads
    step_s: of the grid
    """

    def __init__(self, controller: Controller, loads: PlannedLoads, step_s: float) -> None:
        self._controller, self._loads, self._step_s = controller, loads, step_s
        count = round(_UNTIL_S / max(_EVERY_S, step_s))
        self._steps = tuple(steps_in((i + 1) * max(_EVERY_S, step_s), step_s) for i in range(max(count, 1)))
        self._made: dict[ScenarioRequest, ScenarioPage] = {}
        """Of the latest step: whoever asks the same again costs nothing."""
        self._forecast: Forecast | None = None
        self._k: int | None = None
        """Of the step that both are of."""

    def __call__(self, asked: ScenarioRequest, now: datetime) -> ScenarioPage:
        """Raises ValueError for a load that is not planned, OSError before there is a forecast."""
        if self._k != self._controller.last_k:
            self._k, self._made = self._controller.last_k, {}
            self._forecast = self._controller.forecast(self._steps)
        if asked not in self._made:
            loads, forecast = self._loads.of(asked.load), self._forecast
            if forecast is None:
                raise OSError("there is no forecast yet: it comes with the first grid step")
            lasting = steps_in(60.0 * asked.minutes, self._step_s)
            changes = self._loads.during(loads, lasting, self._steps[-1]) if loads else None
            run = None if changes is None else self._controller.along(changes, self._steps)
            self._made[asked] = ScenarioPage(
                now.isoformat(),
                forecast.k,
                forecast.ahead_s,
                float(asked.minutes),
                loads,
                courses(forecast.value, forecast.sigma),
                {} if run is None else courses(run.value, run.sigma),
            )
        return self._made[asked]
