"""Reasons for the estimates, in names and micrometres, for people."""

from collections.abc import Sequence

import numpy as np

from talc.explanation import ErrorReason, Explanation
from talc.frame import FloatArray
from talc.learner.experts import Expert
from talc.learner.learner import Estimate

_SHOWN = 5
"""Number of inputs that are named for an error."""
KINDS = ("zero", "all inputs", "chosen inputs", "other machines")
"""Kinds of experts, by what they predict from."""


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
    for expert, weight in zip((None, *experts), weights.tolist(), strict=True):
        kind = KINDS[0] if expert is None else KINDS[3] if expert.others else KINDS[2 if expert.evidence else 1]
        sums[kind] = sums.get(kind, 0.0) + weight
    return tuple(sorted(sums.items(), key=lambda item: -item[1]))
