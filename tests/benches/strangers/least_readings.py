"""How many readings the gateway must have, of what a plain client has."""

from collections.abc import Sequence

READ = 0.75
"""Share of the plain client's readings that the gateway must have."""
FEW = 2.0
"""So many fewer are chance."""
IN_TIME = 0.9
"""Of the period: what the plain client has read by then."""
_READ_LATE = 0.2
"""The share that the gateway must have of what the plain client reads at all."""
_OFTEN = 0.5
"""In this share of the periods at least the plain client reads what it can read."""


def least_readings(rounds: Sequence[float | None], period_s: float) -> float:
    """rounds: when the plain client had read all, after the round was due; None: it could not."""
    theirs = sum(took_s is not None for took_s in rounds)
    in_time = sum(took_s is not None and took_s < IN_TIME * period_s for took_s in rounds)
    return max(READ * in_time if in_time >= _OFTEN * len(rounds) else 0.0, _READ_LATE * theirs) - FEW
