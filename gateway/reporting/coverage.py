"""How often later measurements confirm what the report says of uncertainty and tolerance."""

from dataclasses import dataclass

import numpy as np

from gateway.reporting.data import ReportData
from gateway.reporting.figures import Summary
from talc.indicators import TWO_SIDED_95


@dataclass(frozen=True, slots=True)
class Covered:
    """One thermal error: the 95 % intervals that were stated before measurements, and how many of these lay within."""

    error: int
    half: float
    """Median half width of the intervals, with a measurement's own uncertainty; NaN: none was compared."""
    compared: int
    inside: int


def covered(data: ReportData) -> tuple[Covered, ...]:
    """By thermal error. The interval of a step is that of the step before it, which did not know the measurement yet;
    steps after a gap, and errors that were not corrected, are not compared."""
    noise = np.zeros(9) if data.noise is None else np.where(np.isfinite(data.noise), data.noise, 0.0)
    follows = np.diff(data.k) == 1
    before = data.sigma[:-1]
    half = TWO_SIDED_95 * np.hypot(before, noise)
    missed = np.abs(data.measured[1:] - data.predicted[1:])
    known = np.isfinite(missed) & np.isfinite(half) & follows[:, None]
    if data.trusted is not None:
        known &= data.trusted[:-1]
    found = []
    for e in range(data.sigma.shape[1]):
        own = known[:, e]
        width = float(np.median(half[own, e])) if own.any() else float("nan")
        found.append(Covered(e, width, int(own.sum()), int((missed[own, e] <= half[own, e]).sum())))
    return tuple(found)


def within_tolerance(data: ReportData, s: Summary) -> tuple[float, float] | None:
    """The share of instants at which all axes were within the tolerance, without and with compensation, since
    corrections began. None: there is no tolerance, or no course at the tool."""
    if data.tolerance_um is None or s.course is None:
        return None
    use = s.course.between(s.begin_hours * 3600.0, float("inf"))
    if not use.any():
        return None
    before, after = (
        float((np.abs(values[use]) <= data.tolerance_um).all(axis=1).mean())
        for values in (s.course.before, s.course.after)
    )
    return before, after
