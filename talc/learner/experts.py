"""The hyper-parameters of the Gaussian processes that run side by side."""

from dataclasses import dataclass
from typing import Final

UNIT: Final = 10.0
"""µm or µm/m: the size of a thermal error that one span of all inputs together may cause, a priori."""


@dataclass(frozen=True, slots=True)
class Expert:
    """One Gaussian process: y = phi' w + f(phi) + b + noise, with features phi. Sizes count in UNIT."""

    linear: float
    """Prior standard deviation of phi' w while every feature is 1."""
    level: float
    """Standard deviation of the change of b in 5 min, a random walk."""
    smooth: float = 0.0
    """Standard deviation of f far from the reference, where it is 0: a smooth function, which varies over distances of
    about one in every feature."""
    misfit: float = 0.0
    """Standard deviation of what none of this expresses; independent from one measurement to the next."""
    evidence: bool = False
    """Each input has its own prior variance, found from the measurements (automatic relevance determination)."""
    others: bool = False
    """The weights start as other machines have learnt them; `linear` then multiplies their standard deviations."""


STEADY: Final = Expert(0.5, 0.0005, misfit=0.05, evidence=True)
"""Few inputs, linear, with a level that hardly moves: best while a machine behaves as before. Half a micrometre of
misfit is the noise of a good probing cycle: what no lag expresses is not taken for a new level."""
SUPPLE: Final = Expert(5.0, 0.02, smooth=2.0)
"""All inputs, linear and not, with a level that follows: best on a machine that is not linear, or changes."""
EXPERTS: Final = (STEADY, SUPPLE)
"""The same for every machine, error and input. Beside them stands a third one: the error is zero at all times."""
OTHERS_EXPERTS: Final = (Expert(1.0, 0.002, misfit=0.05, others=True), Expert(2.0, 0.02, others=True))
"""Added to the others if there is a prior from other machines."""
