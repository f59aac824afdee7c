"""Reasons for the estimates, in names and micrometres, for people."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from talc.frame import FloatArray, Why
from talc.learner.experts import Expert
from talc.learner.learner import Estimate, Explanation

_SHOWN = 5
"""Number of inputs that are named for an error."""
KINDS = ("last measurement held", "all inputs", "chosen inputs", "other machines")
"""Kinds of experts, by what they predict from."""


@dataclass(frozen=True, slots=True)
class ErrorReason:
    """The reasons for one thermal error; µm or µm/m. NaN: not known before its first measurement."""

    error: str
    estimate: float
    """The present correction: the sum of `inputs`, `other_inputs` and `level`."""
    trusted: bool
    """Whether it is corrected; otherwise no estimate is better than none."""
    believed: float
    """Probability that the error is not just zero."""
    inputs: tuple[tuple[str, float], ...]
    """Which inputs move it now and how far, the largest first."""
    other_inputs: float
    """The effect of all other inputs together."""
    level: float
    """The part that no input explains."""
    experts: tuple[tuple[str, float], ...]
    """Weight of each kind of expert (KINDS), the largest first."""
    expected: float
    """At the next measurement, if the inputs stay as they are."""
    expected_sigma: float
    """Its standard uncertainty, without the noise of the measurement."""


@dataclass(frozen=True, slots=True)
class Reasons:
    """The reasons for all errors, at one grid step."""

    k: int
    next_k: int
    """When the next measurement is expected, if the inputs stay as they are and the machine has time for it."""
    next_why: Why
    errors: tuple[ErrorReason, ...]


def reasons_for(
    errors: Sequence[str],
    names: Sequence[str],
    experts: Sequence[Expert],
    now: Estimate,
    then: Estimate,
    why: Explanation,
) -> tuple[ErrorReason, ...]:
    """In the order of the errors; `then`: at the next measurement."""
    found = []
    for j, error in enumerate(errors):
        parts = why.inputs[j]
        largest = [int(i) for i in np.argsort(-np.abs(parts), kind="stable")[:_SHOWN] if parts[i] != 0.0]
        shown = float(parts[largest].sum())
        found.append(
            ErrorReason(
                error=error,
                estimate=float(now.value[j]),
                trusted=bool(now.trusted[j]),
                believed=float(why.believed[j]),
                inputs=tuple((names[i], float(parts[i])) for i in largest),
                other_inputs=float(parts.sum()) - shown,
                level=float(why.level[j]),
                experts=_by_kind(experts, why.experts[j]),
                expected=float(then.value[j]),
                expected_sigma=float(then.sigma[j]),
            )
        )
    return tuple(found)


def _by_kind(experts: Sequence[Expert], weights: FloatArray) -> tuple[tuple[str, float], ...]:
    sums: dict[str, float] = {}
    for expert, weight in zip(experts, weights.tolist(), strict=True):
        kind = KINDS[0] if expert.weight == 0.0 else KINDS[3] if expert.others else KINDS[2 if expert.evidence else 1]
        sums[kind] = sums.get(kind, 0.0) + weight
    return tuple(sorted(sums.items(), key=lambda item: -item[1]))
