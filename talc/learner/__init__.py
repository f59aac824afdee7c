"""Thermal errors as weighted lags of the inputs, learnt at every measurement by a mixture of Kalman filters."""

from talc.learner.course import CourseState, LearningCourse
from talc.learner.forecast import Forecast, ForecastRecord, Misses, PlannedForecast
from talc.learner.learner import Explanation, LearnerState, RowLearner, Weights, learner_bytes
from talc.learner.mixture import MixtureState
from talc.learner.prior import Prior, make_prior
from talc.learner.reasons import ErrorReason, Reasons

__all__ = [
    "CourseState",
    "ErrorReason",
    "Explanation",
    "Forecast",
    "ForecastRecord",
    "LearnerState",
    "LearningCourse",
    "Misses",
    "MixtureState",
    "PlannedForecast",
    "Prior",
    "Reasons",
    "RowLearner",
    "Weights",
    "learner_bytes",
    "make_prior",
]
