"""Thermal errors as functions of lagged inputs, learnt at every measurement by Gaussian processes."""

from talc.learner.course import CourseState, LearningCourse
from talc.learner.learner import LearnerState, RowLearner
from talc.learner.prior import Prior, make_prior
from talc.learner.told import MixtureState

__all__ = [
    "CourseState",
    "LearnerState",
    "LearningCourse",
    "MixtureState",
    "Prior",
    "RowLearner",
    "make_prior",
]
