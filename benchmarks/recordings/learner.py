"""The learner run through the controller, measured at given times or on request."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from benchmarks.recordings.methods import Given, MethodCourse
from benchmarks.recordings.models import slots
from talc.control import Controller
from talc.frame import BoolArray, Frame, Measurement
from talc.names import THERMAL_ERRORS
from talc.settings import LearnerSettings, TalcSettings

_ERRORS = len(THERMAL_ERRORS)


@dataclass(frozen=True, slots=True)
class Learning:
    """The default method with its default settings: nothing is adjusted to a recording."""

    name: str = "learner"
    settings: LearnerSettings = field(default_factory=LearnerSettings)

    def courses(self, given: Given) -> Sequence[MethodCourse]:
        return [_run(given, self.settings, given.used)[0]]

    def decide(self, given: Given, limit: float) -> tuple[MethodCourse, BoolArray]:
        """Measured throughout the dense beginning, where a run begins like those of a fixed interval, and then whenever
        the learner asks. limit: µm; µm/m in proportion."""
        share = self.settings.limit_um_per_m / self.settings.limit_um
        settings = replace(self.settings, policy="uncertainty", limit_um=limit, limit_um_per_m=share * limit)
        return _run(given, settings, None)


def _run(given: Given, settings: LearnerSettings, used: BoolArray | None) -> tuple[MethodCourse, BoolArray]:
    """A controller for each nine errors, measured together: in the used rows; or (None) when any of them asks, and at
    the beginning of a run if a fixed interval measures there, too."""
    groups = [(list(group), list(group.values())) for group in slots(given.angle)]
    controllers = [
        Controller(given.input_names, TalcSettings(method="learner", learner=settings), given.step_s) for _ in groups
    ]
    estimate, stated = np.full((2, *given.measured.shape), np.nan)
    valid, available, dense = np.isfinite(given.inputs), given.used, given.on_steps < given.dense_steps
    made, asked, run = np.zeros(len(given.k), dtype=np.bool_), True, -1
    for row, k in enumerate(given.k.tolist()):
        begins = given.measure_first and int(given.run[row]) != run
        due = bool(dense[row]) or begins or asked if used is None else bool(used[row])
        made[row] = due and available[row]
        if made[row]:
            run = int(given.run[row])
        asked = False
        for controller, (places, errors) in zip(controllers, groups, strict=True):
            measurement = None
            if made[row]:
                values, sigma = np.full((2, _ERRORS), np.nan)
                values[places], sigma[places] = given.measured[row, errors], given.sigma[errors]
                measurement = Measurement(values, sigma)
            anew = bool(given.new_reference[row])
            decision = controller.step(Frame(k, given.inputs[row], valid[row], measurement, new_reference=anew))
            estimate[row, errors] = decision.predicted[places]
            if not made[row]:  # afterwards it is the uncertainty with the measurement
                stated[row, errors] = decision.sigma[places]
            asked = asked or decision.measure is not None
    return MethodCourse(estimate, stated), made
