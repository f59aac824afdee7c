"""What the learner's mixture knows, and what it says of a measurement."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from numpy import bool_, int64
from numpy.typing import NDArray

from talc.frame import FloatArray


@dataclass(slots=True, eq=False)
class MixtureState:
    """The whole state. n rows, p features, E processes; factors follow from it."""

    x: FloatArray
    """(n, p) features of the rows."""
    time: FloatArray
    """(n,) in drift steps since the reference; `weight` (n,) how many measurements a row stands for."""
    weight: FloatArray
    jolt: FloatArray
    """(n, 9) variance that gaps and jumps had added to the level by then; `y` (n, 9) what was measured."""
    y: FloatArray
    noise: FloatArray
    """(n, 9) variances; infinite: not measured."""
    relevance: FloatArray
    """(9, E, inputs) prior variances of an input's weights over their first ones."""
    reference: FloatArray
    """(9,) variance of the reference's noise."""
    evidence: FloatArray
    """(9, E + 1) discounted log-likelihoods of zero and the processes; their weights follow from it."""
    zero: FloatArray
    """(9, 4) discounted sums of 1, y, y² over the noise's variance, and of its logarithm."""
    now: float
    """Drift steps since the reference; `jolted` (9,) the present variances of `jolt`."""
    jolted: FloatArray
    elapsed: FloatArray
    """(9,) drift steps since the last measurement of each error."""
    count: NDArray[int64]
    """(9,) measurements so far."""
    suspect: FloatArray
    """(9,) the last innovation, if it was an outlier; else 0."""
    off: FloatArray
    """(9,) the last innovation over its standard deviation."""
    last: FloatArray
    """(9,) the last measurement that was not an outlier; NaN before the first."""
    cursor: int
    """The next error whose prior variances are renewed."""
    before: NDArray[int64]
    """(9,) rows before the first far measurement of a day that may be taken back; -1: none. `former_`: as then."""
    former_jolted: FloatArray
    former_last: FloatArray
    former_evidence: FloatArray
    former_zero: FloatArray
    refused: FloatArray
    """(9,) the last measurement, if it was an outlier; else NaN."""
    references: int = 0
    """Times that errors have begun to count anew."""


class MeasurementFault(StrEnum):
    """What is reported instead of a measurement."""

    STUCK = "stuck"
    """The last outlier again, to the last digit: a displacement sensor at its limit."""
    THOUSANDTH = "thousandth"
    """As expected if it is in mm instead of µm."""
    THOUSANDFOLD = "thousandfold"
    """As expected if it is in nm."""


@dataclass(frozen=True, slots=True, eq=False)
class Surprise:
    """How a measurement compared with its prediction, per error; NaN where not measured."""

    ratio: FloatArray
    """(9,) innovations over their standard deviations."""
    outlier: NDArray[bool_]
    """(9,) treated as an outlier: it has little effect."""
    faults: Mapping[int, MeasurementFault]
    """Of errors whose measurement is none, and was not learnt from."""
    forgotten: NDArray[int64]
    """(9,) measurements before it that this one has shown to be wrong, and that are forgotten."""
    variance: FloatArray
    """(9,) of what was expected, a measurement's own noise aside."""
