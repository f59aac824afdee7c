"""The time limit for correcting an error without a model by its last measurement."""

from collections.abc import Sequence

import numpy as np

from talc.frame import BoolArray, Decision, Measurement


class LastMeasured:
    """When each thermal error was last measured.

    Parameters
    ----------
    longest_s: older measurements are no longer used
    since_s: (9,) monotonic seconds of each error's last measurement, -inf for none
    """

    def __init__(self, longest_s: float, since_s: Sequence[float]) -> None:
        self._longest, self._since = longest_s, np.asarray(since_s, dtype=float)

    def measured(self, measurement: Measurement, now_s: float) -> None:
        self._since = np.where(np.isfinite(measurement.errors), now_s, self._since)

    def remembered(self, since_s: Sequence[float]) -> None:
        """When errors were measured that had no known time, (9,) monotonic seconds; -inf: still not known."""
        self._since = np.where(np.isneginf(self._since), since_s, self._since)

    def outdated(self, decision: Decision, now_s: float) -> BoolArray:
        """(9,) whether an error is known by its last measurement only, and that one is too old."""
        without_model = ~np.isfinite(decision.predicted)
        return np.asarray(without_model & (now_s - self._since > self._longest))
