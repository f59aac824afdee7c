"""Places what a controller has learnt on a controller with other inputs, by the names of the inputs."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from talc.control import ControllerState
from talc.frame import IntArray
from talc.hold import HeldState, MeasureAndHold
from talc.learner import CourseState, LearnerState, LearningCourse, MixtureState
from talc.learner.experts import EXPERTS
from talc.learner.mixture import Mixture
from talc.papers.phased import PhasedModels, PhasedState

_NOT_HERE = -1
_METHODS = {strategy.state_class: strategy.method for strategy in (LearningCourse, PhasedModels, MeasureAndHold)}
_Scalar = TypeVar("_Scalar", bound=np.generic)


def transferred(state: ControllerState, fresh: ControllerState) -> ControllerState:
    """What `state` knows, for the controller that `fresh` is the state of, which has taken no step yet.

    Of a learner, what inputs that are not here have explained is taken from its measurements, and the weights of new
    inputs begin as without any knowledge. A model whose inputs are not all here is left out. Grid indices are left out:
    a measurement is wanted at once.

    Raises ValueError: the two are of different methods, or were made with and without a prior.
    """
    match state.strategy, fresh.strategy:
        case CourseState() as old, CourseState() as new:
            return replace(fresh, strategy=_course(old, state.input_names, new, fresh.input_names))
        case PhasedState() as old_phased, PhasedState() as new_phased:
            return replace(fresh, strategy=_phased(old_phased, new_phased, set(fresh.input_names)))
        case HeldState() as old_held, HeldState():
            return replace(fresh, strategy=replace(old_held, last_measured=None))
        case old, new:
            had, wanted = _METHODS[type(old)], _METHODS[type(new)]
            raise ValueError(f"it was learnt with [talc] method = {had!r}, and here it is {wanted!r}")


def _phased(old: PhasedState, fresh: PhasedState, names: set[str]) -> PhasedState:
    return replace(
        fresh,
        phase=old.phase,
        models=tuple(None if m is None or not set(m[0].inputs) <= names else m for m in old.models),
        held=old.held.copy(),
        measured_in_phase=old.measured_in_phase,
        static=None if old.static is None else tuple(_kept(inputs, names) for inputs in old.static),
    )


def _kept(inputs: tuple[str, ...] | None, names: set[str]) -> tuple[str, ...] | None:
    return None if inputs is None or not set(inputs) <= names else inputs


def _course(old: CourseState, was: Sequence[str], fresh: CourseState, names: Sequence[str]) -> CourseState:
    return replace(
        old,
        learner=_learner(old.learner, fresh.learner, was, names),
        last_k=None,
        last_measured=None,
        wanted=None,
        substituted=frozenset(),
        tolerance_um=0.0,
    )


def _learner(old: LearnerState, fresh: LearnerState, was: Sequence[str], names: Sequence[str]) -> LearnerState:
    inputs = np.array([was.index(name) if name in was else _NOT_HERE for name in names], dtype=np.int64)
    square = np.ix_(inputs, inputs)
    both = (inputs[:, None] >= 0) & (inputs[None, :] >= 0)
    return replace(
        old,
        mixture=_mixture(old.mixture, fresh.mixture, inputs, old.level.shape[1]),
        level=_taken(old.level, fresh.level, inputs),
        origin=_taken(old.origin, fresh.origin, inputs),
        span=_taken(old.span, fresh.span, inputs),
        wide=_taken(old.wide, fresh.wide, inputs),
        reference=_taken(old.reference, fresh.reference, inputs),
        known=_taken(old.known, fresh.known, inputs),
        last=_taken(old.last, fresh.last, inputs),
        away=_taken(old.away, fresh.away, inputs),
        mean=_taken(old.mean, fresh.mean, inputs),
        habit=_taken(old.habit, fresh.habit, inputs),
        fault=fresh.fault,
        covariance=np.where(both, old.covariance[square], fresh.covariance),
    )


def _taken(old: NDArray[_Scalar], fresh: NDArray[_Scalar], at: IntArray) -> NDArray[_Scalar]:
    """(n, ...) rows of `old` where it has them, else of `fresh`."""
    there = (at >= 0).reshape(-1, *[1] * (old.ndim - 1))
    return np.where(there, old[at], fresh)


def _mixture(old: MixtureState, fresh: MixtureState, inputs: IntArray, lags: int) -> MixtureState:
    """What an input that is not here has explained is taken from the rows; of a new one they say nothing."""
    if old.evidence.shape != fresh.evidence.shape:
        raise ValueError(
            f"it has {old.evidence.shape[1]} experts and the learner here has {fresh.evidence.shape[1]}: "
            "only one of the two has a prior, or another version of the program has learnt it"
        )
    many = old.relevance.shape[2]
    gone = np.repeat(~np.isin(np.arange(many), inputs), lags)
    y = old.y
    if gone.any() and len(old.x):
        # What other machines have learnt is in no state: the experts that started with it are left out.
        own, known = len(EXPERTS), Mixture(many, lags, 300.0, errors=old.y.shape[1])
        known.restore(replace(old, relevance=old.relevance[:, :own], evidence=old.evidence[:, : own + 1]))
        y = old.y - old.x[:, gone] @ known.weights()[:, gone].T
    lagged = np.where(inputs[:, None] >= 0, inputs[:, None] * lags + np.arange(lags), _NOT_HERE).ravel()
    x = np.where(lagged >= 0, old.x[:, lagged], 0.0)
    return replace(old, x=x, y=y, relevance=np.where(inputs >= 0, old.relevance[:, :, inputs], 1.0))
