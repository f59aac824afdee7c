"""Differences between two methods over the same repetitions, with the uncertainty of their mean."""

from dataclasses import dataclass

import numpy as np

from studies.page import rounded_text
from talc.frame import FloatArray


@dataclass(frozen=True, slots=True)
class Paired:
    """Mean reduction of the second relative to the first, and twice its standard error; NaN for a single pair."""

    less: float
    reach: float
    better: int
    """Pairs in which the second is smaller."""
    pairs: int

    @property
    def sure(self) -> bool:
        """Whether the second is smaller by more than twice the standard error; of a single pair, smaller at all."""
        return bool(self.less > (0.0 if np.isnan(self.reach) else self.reach))

    def __str__(self) -> str:
        how_sure = "" if np.isnan(self.reach) else f" ± {rounded_text(self.reach, 2)}"
        size = f"{rounded_text(abs(self.less), 2)}{how_sure} {'less' if self.less >= 0 else 'more'}"
        return f"{size}, less in {self.better} of {self.pairs}"


def paired(first: FloatArray, second: FloatArray) -> Paired:
    """(runs,) each, in the same order of repetitions."""
    less = first - second
    reach = 2 * float(less.std(ddof=1)) / np.sqrt(len(less)) if len(less) > 1 else float("nan")
    return Paired(float(less.mean()), reach, int((less > 0).sum()), len(less))
