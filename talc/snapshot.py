"""The controller's state as plain values and arrays, so that it can be kept and continued from, bit for bit."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from talc.control import ControllerState
from talc.frame import Frames, Phase, Why
from talc.hold import HeldState
from talc.learner import CourseState, LearnerState, MixtureState
from talc.learner.plausible import InputCheck
from talc.models import ErrorModel
from talc.names import THERMAL_ERRORS
from talc.papers.phased import PhasedState
from talc.record import refilled

_FORMAT = 4
_OF_MODELS = 2, 3
"""Earlier formats, which differ in the learner only."""
Arrays = Mapping[str, NDArray[Any]]


_LEARNER = "learner."
_MIXTURE = "mixture."


def to_plain(state: ControllerState) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """JSON-able values and arrays of a state. Of its record only the oldest row: the rest follows from the frames."""
    course = state.course
    phased = state.strategy if isinstance(state.strategy, PhasedState) else _without_models(state.strategy)
    plain: dict[str, Any] = {
        "format": _FORMAT,
        "input_names": state.input_names,
        "last_k": state.last_k,
        "rows": len(state.inputs),
        "phase": phased.phase,
        "models": [None if known is None else [known[0].to_dict(), known[1]] for known in phased.models],
        "learning": phased.learning,
        "measured_in_phase": phased.measured_in_phase,
        "last_measured": phased.last_measured,
        "substituted": sorted(phased.substituted),
        "bounded": sorted(phased.bounded),
        "static": phased.static,
    }
    arrays: dict[str, NDArray[Any]] = {"first": state.inputs[:1], "held": phased.held}
    if phased.estimates:
        arrays["estimated_k"] = np.array(list(phased.estimates), dtype=np.int64)
        arrays["estimated"] = np.array(list(phased.estimates.values()))
    if isinstance(state.strategy, HeldState):
        plain["hold"] = True
    if course is not None:
        learner, mixture = course.learner, course.learner.mixture
        arrays["trusted"] = course.trusted
        arrays |= {_LEARNER + name: value for name, value in _values(learner) if isinstance(value, np.ndarray)}
        arrays |= {_MIXTURE + name: value for name, value in _values(mixture) if isinstance(value, np.ndarray)}
        plain["course"] = {
            "phase": course.phase,
            "last_k": course.last_k,
            "last_measured": course.last_measured,
            "wanted": course.wanted,
            "measured_in_phase": course.measured_in_phase,
            "substituted": sorted(course.substituted),
            "tolerance_um": course.tolerance_um,
        }
        plain["learner"] = {name: value for name, value in _values(learner) if isinstance(value, int | float)}
        plain["mixture"] = {name: value for name, value in _values(mixture) if isinstance(value, int | float)}
    return plain, arrays


def from_plain(plain: Mapping[str, Any], arrays: Arrays, frames: Callable[[int, int], Frames]) -> ControllerState:
    """The inverse of `to_plain`.

    frames: gives those from a grid index to another one, both included

    Raises ValueError for a format that this program does not know, and KeyError or TypeError for values that no state
    has.
    """
    check_format(plain)
    last_k, rows = plain["last_k"], plain["rows"]
    names = tuple(plain["input_names"])
    inputs, valid = np.empty((0, len(names))), np.empty((0, len(names)), dtype=np.bool_)
    measured = np.empty((0, len(arrays["held"])))
    if rows:
        made_of = frames(last_k + 1 - rows, last_k)
        inputs, valid, measured = refilled(arrays["first"][0], rows, made_of, last_k)
    return ControllerState(
        input_names=names,
        inputs=inputs,
        valid=valid,
        measured=measured,
        last_k=last_k,
        strategy=_strategy(plain, arrays),
    )


def check_format(plain: Mapping[str, Any]) -> None:
    """ValueError: a state in this format cannot be continued from."""
    number = plain["format"]
    if number in _OF_MODELS and "course" in plain:
        raise ValueError(f"format = {number}: of an earlier learner; its record, replayed, teaches this one the same")
    if number not in (*_OF_MODELS, _FORMAT):
        raise ValueError(f"format = {number!r}: expected {_FORMAT}")


def _strategy(plain: Mapping[str, Any], arrays: Arrays) -> CourseState | PhasedState | HeldState:
    if "course" in plain:
        return _course(plain, arrays)
    if "hold" in plain:
        return HeldState(
            phase=Phase(plain["phase"]),
            held=arrays["held"],
            measured_in_phase=plain["measured_in_phase"],
            last_measured=plain["last_measured"],
        )
    return PhasedState(
        phase=Phase(plain["phase"]),
        models=tuple(
            None if known is None else (ErrorModel.from_dict(known[0]), known[1]) for known in plain["models"]
        ),
        held=arrays["held"],
        learning=plain["learning"],
        measured_in_phase=plain["measured_in_phase"],
        last_measured=plain["last_measured"],
        substituted=frozenset(plain["substituted"]),
        bounded=frozenset(plain["bounded"]),
        static=None if plain["static"] is None else tuple(None if s is None else tuple(s) for s in plain["static"]),
        estimates={
            int(k): row for k, row in zip(arrays.get("estimated_k", ()), arrays.get("estimated", ()), strict=True)
        },
    )


def _without_models(state: CourseState | HeldState) -> PhasedState:
    """What a snapshot says of models where there are none, so that every program reads it."""
    held = state if isinstance(state, HeldState) else None
    return PhasedState(
        phase=state.phase,
        models=(None,) * len(THERMAL_ERRORS),
        held=np.full(len(THERMAL_ERRORS), np.nan) if held is None else held.held,
        learning=False,
        measured_in_phase=0 if held is None else held.measured_in_phase,
        last_measured=None if held is None else held.last_measured,
        substituted=frozenset(),
        bounded=frozenset(),
        static=None,
    )


def _course(plain: Mapping[str, Any], arrays: Arrays) -> CourseState:
    course = plain["course"]
    of_mixture = _own(arrays, _MIXTURE)
    of_mixture = _fresh_mixture(of_mixture["evidence"]) | of_mixture
    mixture = MixtureState(**plain["mixture"], **of_mixture)
    own = _own(arrays, _LEARNER)
    own = _fresh(*own["level"].shape) | own  # of a program that knew one reference and judged no inputs
    return CourseState(
        learner=LearnerState(mixture=mixture, **plain["learner"], **own),
        phase=Phase(course["phase"]),
        last_k=course["last_k"],
        last_measured=course["last_measured"],
        wanted=None if course["wanted"] is None else Why(course["wanted"]),
        measured_in_phase=course["measured_in_phase"],
        trusted=arrays["trusted"],
        substituted=frozenset(course["substituted"]),
        tolerance_um=course.get("tolerance_um", 0.0),  # an earlier program knew none
    )


def _values(state: LearnerState | MixtureState) -> Iterator[tuple[str, Any]]:
    return ((field.name, getattr(state, field.name)) for field in fields(state))


def _own(arrays: Arrays, prefix: str) -> dict[str, Any]:
    return {name.removeprefix(prefix): value for name, value in arrays.items() if name.startswith(prefix)}


def _fresh(inputs: int, lags: int) -> dict[str, Any]:
    """What a learner knows that earlier programs did not keep."""
    check = InputCheck(inputs, 300.0)
    return {"origin": np.zeros((inputs, lags)), "habit": check.habit, "fault": check.fault}


def _fresh_mixture(evidence: NDArray[Any]) -> dict[str, Any]:
    """The same of its mixture: no day that may be taken back."""
    errors = len(evidence)
    former = {"former_jolted": np.zeros(errors), "former_last": np.zeros(errors)}
    former |= {"former_evidence": np.zeros_like(evidence), "former_zero": np.zeros((errors, 4))}
    return former | {"before": np.full(errors, -1, dtype=np.int64), "refused": np.full(errors, np.nan)}
