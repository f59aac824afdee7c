"""The papers' methods and the sparse models, run through the whole controller: calibration, limits, updates."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from benchmarks.recordings.methods import Given, MethodCourse
from talc.control import Controller
from talc.frame import BoolArray, Frame, Measurement
from talc.names import ERROR_UNITS, MICROMETRE, THERMAL_ERRORS
from talc.papers.training import train
from talc.settings import ControlSettings, TalcSettings, TrainingSettings

_ERRORS = len(THERMAL_ERRORS)
_POSITIONS = tuple(i for i, name in enumerate(THERMAL_ERRORS) if ERROR_UNITS[name] == MICROMETRE)
_ANGLES = tuple(i for i in range(_ERRORS) if i not in _POSITIONS)
_DAY_S = 86400.0
_LEAST_MEASUREMENTS = 12
"""Number of measurements that a controller's calibration takes."""


def slots(angle: BoolArray) -> list[dict[int, int]]:
    """The controller's nine places for any number of errors: by group, place to error, µm in µm and µm/m in µm/m."""
    groups: list[dict[int, int]] = []
    for places, errors in ((_POSITIONS, np.flatnonzero(~angle)), (_ANGLES, np.flatnonzero(angle))):
        for number, error in enumerate(errors.tolist()):
            group, place = divmod(number, len(places))
            while len(groups) <= group:
                groups.append({})
            groups[group][places[place]] = error
    return groups


@dataclass(frozen=True, slots=True)
class Models:
    """Models that a training finds after a calibration, then the controller's updates."""

    name: str
    training: TrainingSettings = field(default_factory=TrainingSettings)
    gaps: bool = True
    """Steps that were not recorded are missing values; otherwise each recorded step follows the one before."""
    most_trainings: int = 8
    """At most this many trainings, the first models' included: a swarm would need hours for weeks of hourly
    measurements."""

    def courses(self, given: Given) -> Sequence[MethodCourse]:
        if not self.gaps:
            given = replace(given, k=np.arange(len(given.k)))
        settings = self._settings(given)
        if settings is None:
            return []
        estimate, sigma = np.full((2, *given.measured.shape), np.nan)
        for group in slots(given.angle):
            places, errors = list(group), list(group.values())
            found = _controlled(given, places, errors, settings, self.most_trainings)
            estimate[:, errors], sigma[:, errors] = found.estimate[:, places], found.sigma[:, places]
        return [MethodCourse(estimate, sigma)]

    def _settings(self, given: Given) -> TalcSettings | None:
        """None: this selector needs a calibration with a measurement at every step."""
        each_step = self.training.selector != "search"
        if given.dense_steps >= _LEAST_MEASUREMENTS:
            control = ControlSettings(calibration_steps=given.dense_steps)
        elif each_step:
            return None
        else:
            every = given.interval_steps
            steps = max(round(_DAY_S / given.step_s), _LEAST_MEASUREMENTS * every)
            control = ControlSettings(calibration_steps=steps, calibration_interval_steps=every)
        return TalcSettings(method="models", control=control, training=self.training)


def _controlled(
    given: Given, places: list[int], errors: list[int], settings: TalcSettings, most_trainings: int
) -> MethodCourse:
    """(T, 9) of one controller, measured when the others are; a training ends within its step."""
    controller = Controller(given.input_names, settings)
    rows = len(given.k)
    estimate, stated = np.full((2, rows, _ERRORS), np.nan)
    in_force, uncertainty = np.full(_ERRORS, np.nan), np.full(_ERRORS, np.nan)
    uncertainty[places] = given.sigma[errors]
    valid, used = np.isfinite(given.inputs), given.used
    for row, k in enumerate(given.k.tolist()):
        measurement = None
        if used[row]:
            values = np.full(_ERRORS, np.nan)
            values[places] = given.measured[row, errors]
            measurement = Measurement(values, uncertainty)
        decision = controller.step(Frame(k, given.inputs[row], valid[row], measurement))
        # The offsets on the control before this row's measurement: an error without a model is held.
        estimate[row] = np.where(np.isfinite(decision.predicted), decision.predicted, in_force)
        if not used[row]:  # afterwards it is the uncertainty with the measurement
            stated[row] = decision.sigma
        in_force = decision.corrected
        if decision.training is not None and most_trainings > 0:
            most_trainings -= 1
            controller.adopt(train(decision.training))
    return MethodCourse(estimate, stated)


_WEEK_STEPS = 2016
_SEARCH = TrainingSettings(selector="search", window_steps=_WEEK_STEPS)
_SWARM = TrainingSettings(selector="pso", max_na=5, max_nb=5, estimator="least_squares", window_steps=_WEEK_STEPS)
_CLUSTERS = TrainingSettings(selector="tck", max_na=1, max_nb=1, estimator="least_squares", window_steps=_WEEK_STEPS)
_MOST_BY_SWARM = 3


def papers(*, gaps: bool) -> tuple[Models, ...]:
    """The methods that the learner is compared with. gaps: the recording has some, which leave these models few good
    rows; they are therefore also run as if there were none."""
    if not gaps:
        return (
            Models("`search`", _SEARCH),
            Models("`pso`", _SWARM, most_trainings=_MOST_BY_SWARM),
            Models("`tck`", _CLUSTERS),
        )
    return (
        Models("`search`", _SEARCH),
        Models("`search`, gaps cut out", _SEARCH, gaps=False),
        Models("`pso`, gaps cut out", _SWARM, gaps=False, most_trainings=_MOST_BY_SWARM),
        Models("`tck`, gaps cut out", _CLUSTERS, gaps=False),
    )
