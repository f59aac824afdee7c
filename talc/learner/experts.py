"""The hyper-parameters of the filters that run side by side."""

from dataclasses import dataclass
from itertools import product
from typing import Final

UNIT: Final = 10.0
"""µm or µm/m: the size of a thermal error that one span of all inputs together may cause, a priori."""


@dataclass(frozen=True, slots=True)
class Expert:
    """One filter of y = phi' w + b + noise; w and b are random walks. Sizes count in UNIT."""

    weight: float
    """Prior standard deviation of phi' w while every feature is 1. 0: measure-and-hold."""
    level: float
    """Standard deviation of the change of b in 5 min."""
    drift: float = 0.0
    """Standard deviation of the change of phi' w in 5 min while every feature is 1."""
    evidence: bool = False
    """Each input has its own prior variance, found from the posterior (automatic relevance determination)."""

    direct: bool = False
    """Uses only inputs without lags: a regression."""

    others: bool = False
    """Starts with what other machines have learnt; `weight` then multiplies its standard deviations."""

    @property
    def name(self) -> str:
        """The expert in words, for people."""
        if self.weight == 0.0:
            return f"hold {self.level:g}"
        if self.others:
            return f"other machines {self.weight:g}, level {self.level:g}"
        if self.direct:
            return f"regression {self.weight:g}, level {self.level:g}"
        kind = "inputs chosen" if self.evidence else "all inputs"
        return f"{kind} {self.weight:g}, level {self.level:g}" + (f", drift {self.drift:g}" if self.drift else "")


EXPERTS: Final = (
    *(Expert(0.0, level) for level in (0.002, 0.01, 0.04, 0.1)),
    Expert(10.0, 0.005),
    Expert(1.0, 0.02, direct=True),
    Expert(0.5, 0.1),
    *(Expert(a, level, drift=0.02) for a, level in product((0.5, 2.5), (0.002, 0.02))),
    *(Expert(a, level, evidence=True) for a, level in product((0.1, 0.5, 2.5), (0.002, 0.02))),
)
"""The same for every machine, error and input: decades of prior weight and of drift. The experts with evidence are best
while the machine's behaviour stays the same, those whose weights drift when it changes slowly, and those whose level
moves fast when it changes at once."""

OTHERS_EXPERTS: Final = tuple(Expert(a, level, others=True) for a, level in product((1.0, 2.0), (0.002, 0.02)))
"""Added to the others if there is a prior from other machines."""
