"""Indicators of the quality of a compensation (B19 eq. 1-7; Z22 Tables 3 and 4). NaN: not measured, omitted.

Examples
--------
An error of 40 µm peak to peak, of which a tenth is left, and 35 cycles of 2 min in 72 h:

>>> import numpy as np
>>> from talc import indicators
>>> error = 20 * np.sin(np.linspace(0, 2 * np.pi, 201))
>>> indicators.peak_to_peak(error), round(indicators.rms(error), 1)
(40.0, 14.1)
>>> round(indicators.reduction(indicators.rms(error), indicators.rms(0.1 * error)), 1)
90.0
>>> round(indicators.productivity(35, cycle_s=120, total_s=72 * 3600), 1)
98.4
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from talc.frame import FloatArray

TWO_SIDED_95: Final = 1.96
"""Standard deviations on each side of a 95 % interval, of a normal distribution."""

FIRST_HOUR_S: Final = 3600.0
"""Of a run, judged apart: little has been learnt, so its peak says nothing of the rest."""


@dataclass(frozen=True, slots=True)
class Spread:
    """E_PV and E_RMS. NaN: without values."""

    pv: float
    rms: float

    @classmethod
    def of(cls, values: FloatArray) -> "Spread":
        """Of a course (T,), or of several (T, m) together: the largest E_PV of any, and E_RMS over all."""
        each = [peak_to_peak(course) for course in np.atleast_2d(np.asarray(values, dtype=np.float64).T)]
        return cls(max((pv for pv in each if not np.isnan(pv)), default=float("nan")), rms(values))


def first_hour_apart(time_s: FloatArray, values: FloatArray) -> tuple[Spread, Spread]:
    """Of the first hour, and of the rest. time_s: (T,) since the beginning; values: (T,) or (T, m)."""
    early = np.asarray(time_s) < FIRST_HOUR_S
    return Spread.of(values[early]), Spread.of(values[~early])


def pv(measured: FloatArray, predicted: FloatArray) -> float:
    """PV, %: max |m - p| / max |m| · 100 (B19 eq. 1), of the largest deviations and not of ranges. NaN without pairs.

    ValueError: shapes differ.
    """
    m, p = _pairs(measured, predicted)
    largest = float(np.abs(m).max(initial=0.0))
    return 100.0 * float(np.abs(m - p).max()) / largest if largest > 0 else float("nan")


def peak_to_peak(values: FloatArray) -> float:
    """E_PV (Z22 Tables 3 and 4): largest minus smallest. NaN without values."""
    known = _known(values)
    return float(np.ptp(known)) if known.size else float("nan")


def rms(values: FloatArray) -> float:
    """RMSE, E_RMS: root of the mean square about zero. NaN without values."""
    known = _known(values)
    return float(np.sqrt(np.mean(known**2))) if known.size else float("nan")


def p99(values: FloatArray) -> float:
    """P99: 99th percentile of the magnitude by Hazen's rule (B19 eq. 3-5), between the values of rank 0.99 n + 1/2.

    With 50 values or fewer it is the largest one. NaN without values.
    """
    known = _known(values)
    return float(np.percentile(np.abs(known), 99.0, method="hazen")) if known.size else float("nan")


def smape(measured: FloatArray, predicted: FloatArray) -> float:
    """SMAPE, 0 to 100 %: mean of |m - p| / (|m| + |p|); a pair of zeros counts as 0. NaN without pairs.

    Dominated by zero crossings: of little value for errors that change sign. ValueError: shapes differ.
    """
    m, p = _pairs(measured, predicted)
    if not m.size:
        return float("nan")
    size = np.abs(m) + np.abs(p)
    share = np.divide(np.abs(m - p), size, out=np.zeros_like(size), where=np.isfinite(size) & (size > 0))
    share[np.isinf(size)] = 1.0
    return float(100.0 * share.mean())


def productivity(measurements: int, cycle_s: float, total_s: float) -> float:
    """Pd = (1 - M T_M / T_total) · 100 %: share of the time that is not spent probing (B19).

    ValueError: total_s is zero or negative.
    """
    if not total_s > 0:
        raise ValueError(f"total_s = {total_s!r}: expected more than 0")
    return 100.0 * (1.0 - measurements * cycle_s / total_s)


def reduction(before: float, after: float) -> float:
    """Reduction in % of `before`; negative if it increased. NaN if there was nothing to reduce."""
    return 100.0 * (1.0 - after / before) if before > 0 else float("nan")


def _pairs(measured: FloatArray, predicted: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What was both measured and predicted. ValueError: shapes differ."""
    measured, predicted = np.asarray(measured, dtype=np.float64), np.asarray(predicted, dtype=np.float64)
    if measured.shape != predicted.shape:
        raise ValueError(f"measured has shape {measured.shape}, predicted {predicted.shape}: expected the same")
    both = np.isfinite(measured) & ~np.isnan(predicted)  # an infinite prediction stays visible
    return measured[both], predicted[both]


def _known(values: FloatArray) -> FloatArray:
    values = np.asarray(values, dtype=np.float64)
    return values[~np.isnan(values)]  # an infinite residual stays visible
