"""Why a strategy estimates what it does: for programs in arrays, for people in names and micrometres."""

from dataclasses import dataclass

from talc.frame import FloatArray, Why


@dataclass(frozen=True, slots=True, eq=False)
class Explanation:
    """Why the estimates are what they are."""

    inputs: FloatArray
    """(9, n) what each input contributes now, µm or µm/m; with `level` they add up to the estimate."""
    level: FloatArray
    """(9,) the part that no input explains."""
    experts: FloatArray
    """(9, E) weights of the experts, which add up to 1; the first one says that the error is zero."""
    believed: FloatArray
    """(9,) probability that the error is not just zero."""


@dataclass(frozen=True, slots=True, eq=False)
class Weights:
    """What is known of how the errors follow the inputs.

    The estimate of an error is `share` times the sum of `level`, of `smooth`, and of all inputs' weights times the
    deviation of the input from `reference` through a first-order lag. Each sigma is a standard uncertainty by
    itself: those of one error are correlated.
    """

    inputs: FloatArray
    """(9, n, L) of each input through each lag; µm or µm/m per unit of the input."""
    inputs_sigma: FloatArray
    level: FloatArray
    """(9,) µm or µm/m."""
    level_sigma: FloatArray
    smooth: FloatArray
    """(9,) what is not linear in the inputs, at present; µm or µm/m."""
    share: FloatArray
    """(9,) 1; 0 where it is not corrected."""
    reference: FloatArray
    """(n,) in the units of the inputs."""
    time_constants_s: tuple[float, ...]
    """(L,) of the lags; 0: no lag."""


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
    """Weight of each kind of expert, in words, the largest first."""
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
