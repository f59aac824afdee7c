"""Numbers as they are published: what is not finite is null."""

import math

from gateway.telemetry.messages import PublishedCourse
from talc.frame import FloatArray
from talc.names import THERMAL_ERRORS


def courses(value: FloatArray, sigma: FloatArray) -> dict[str, PublishedCourse]:
    """Courses of (S, 9) numbers and their sigma."""
    values, sigmas = columns_by_error(value), columns_by_error(sigma)
    return {error: PublishedCourse(values[error], sigmas[error]) for error in THERMAL_ERRORS}


def columns_by_error(values: FloatArray) -> dict[str, list[float | None]]:
    """The columns of (S, 9) numbers; to a thousandth, so that the message stays small."""
    columns = zip(THERMAL_ERRORS, values.T.tolist(), strict=True)
    return {error: [finite(round(value, 3)) for value in column] for error, column in columns}


def finite(value: float) -> float | None:
    """None for what is not a finite number."""
    return float(value) if math.isfinite(value) else None


def by_error(values: FloatArray) -> dict[str, float | None]:
    """(9,) numbers, by error."""
    return {name: finite(value) for name, value in zip(THERMAL_ERRORS, values.tolist(), strict=True)}
