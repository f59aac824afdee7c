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

    misfit: float = 0.0
    """Standard deviation of what inputs and level do not express; independent from one measurement to the next."""

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
        further = [f", {what} {size:g}" for what, size in (("drift", self.drift), ("misfit", self.misfit)) if size]
        return f"{kind} {self.weight:g}, level {self.level:g}" + "".join(further)


EXPERTS: Final = (
    *(Expert(0.0, level) for level in (0.002, 0.1)),
    Expert(1.0, 0.02, direct=True),
    Expert(2.5, 0.02, drift=0.02),
    Expert(0.5, 0.002, evidence=True),
    *(Expert(a, 0.02, evidence=True) for a in (0.5, 2.5)),
    *(Expert(a, 0.0005, evidence=True, misfit=0.05) for a in (0.1, 0.5, 2.5)),
)
"""The same for every machine, error and input. Sizes are a factor of five or more apart: a mixture needs no finer ones.
The experts that choose inputs are best while the machine's behaviour stays the same. Three of them have a level that
hardly moves, and half a micrometre of misfit, the noise of a good probing cycle: what no lag expresses is not taken for
a new level. The one whose weights drift is best when the behaviour changes slowly, and those whose level moves fast
when it changes at once."""

OTHERS_EXPERTS: Final = tuple(Expert(a, level, others=True) for a, level in product((1.0, 2.0), (0.002, 0.02)))
"""Added to the others if there is a prior from other machines."""
