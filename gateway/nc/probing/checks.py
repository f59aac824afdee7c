"""Decides whether a probing cycle's result is used. Pure except for the one result that awaits confirmation.

In this order: do repeated touches agree, do the centres fit a rigid body that moved (a chip under one touch does not),
does the result agree with what was expected. A surprise that is not absurd may be the machine's new state: a second
cycle, for which the probe was changed again, must confirm it. Between the two the machine goes on warming, so the
second may have moved by anything up to what the prediction moved by.
"""

from dataclasses import dataclass

import numpy as np

from gateway.config.sections import Probing
from gateway.model.codes import NoticeCode
from gateway.model.text import Text
from gateway.nc.probing.cycle import Rejected
from talc.frame import FloatArray, Measurement
from talc.names import ERROR_UNITS, MICROMETRE, THERMAL_ERRORS
from talc.probing import ProbingResult


@dataclass(frozen=True, slots=True)
class Expected:
    """What the nine errors are expected to be; NaN: unknown."""

    errors: FloatArray
    """(9,) the latest prediction; where there is none, the last measurement if that is recent."""
    sigma: FloatArray
    """(9,) its standard uncertainty; NaN if unknown, as for a last measurement."""
    limits: FloatArray
    """(9,) action control limits; NaN: none."""


class MeasurementChecks:
    """Checks results with the settings of [probing].

    Parameters
    ----------
    settings: max_repeat_um, max_residual_um, outlier_sigmas, surprise_sigmas and max_surprise_um are used
    radius_m: distance of the sphere from the C axis: turns µm into µm/m
    """

    def __init__(self, settings: Probing, radius_m: float) -> None:
        self._settings, self._radius = settings, radius_m
        self._candidate: tuple[Measurement, FloatArray] | None = None
        """A surprise, and what was expected instead."""

    def repeats(self, spread_um: float | None) -> None:
        """Raises Rejected when repeated touches of a point differ by too much. None: the control does not report it."""
        if spread_um is not None and not spread_um <= self._settings.max_repeat_um:
            raise Rejected(Text(NoticeCode.TOUCHES_APART, spread_um=spread_um, most_um=self._settings.max_repeat_um))

    def fits(self, result: ProbingResult) -> None:
        """Raises Rejected when the centres are not those of a rigid body that moved; names the pose that stands out."""
        pose, axis = divmod(int(np.nanargmax(np.abs(result.standardised))), 3)
        worst = abs(float(result.standardised[pose, axis]))
        where = Text(NoticeCode.POSE_STANDS_OUT, pose=pose + 1, axis="XYZ"[axis])
        if result.residual_rms > self._settings.max_residual_um:
            most_um = self._settings.max_residual_um
            raise Rejected(Text(NoticeCode.FIT_POOR, rms_um=result.residual_rms, most_um=most_um, where=where))
        if worst > self._settings.outlier_sigmas:
            most = self._settings.outlier_sigmas
            raise Rejected(Text(NoticeCode.CENTRE_OUTLIER, worst=worst, most=most, where=where))

    def plausible(self, found: Measurement, expected: Expected) -> None:
        """Raises Rejected for an absurd result, and for a surprise that the previous result did not show as well."""
        difference = np.abs(found.errors - expected.errors)
        both = self._settings.surprise_sigmas * np.hypot(expected.sigma, found.sigma)
        absurd = np.fmax(self._largest(), both)
        i = _worst(difference, absurd)
        if i is not None:
            self._candidate = None
            raise Rejected(Text(NoticeCode.RESULT_ABSURD, **_values(i, difference), most=float(absurd[i])))
        before, self._candidate = self._candidate, None
        i = _worst(difference, np.fmax(both, expected.limits))
        if i is None:
            return
        if before is not None:
            again = self._settings.surprise_sigmas * np.hypot(before[0].sigma, found.sigma)
            if _worst(_unexplained(found.errors - before[0].errors, expected.errors - before[1]), again) is None:
                return
        self._candidate = found, expected.errors
        raise Rejected(Text(NoticeCode.RESULT_SURPRISING, **_values(i, difference)))

    def _largest(self) -> FloatArray:
        most = self._settings.max_surprise_um
        return np.array([most if ERROR_UNITS[n] == MICROMETRE else most / self._radius for n in THERMAL_ERRORS])


def _worst(difference: FloatArray, limit: FloatArray) -> int | None:
    """Index of the error that exceeds its limit most; None: none does. NaN on either side never exceeds."""
    share = np.nan_to_num(difference / limit, nan=0.0)
    i = int(np.argmax(share))
    return i if share[i] > 1.0 else None


def _unexplained(change: FloatArray, predicted: FloatArray) -> FloatArray:
    """(9,) distance of a change from the range between no change and the predicted one; NaN predicts none."""
    predicted = np.nan_to_num(predicted, nan=0.0)
    return np.abs(change - np.clip(change, np.fmin(predicted, 0.0), np.fmax(predicted, 0.0)))


def _values(i: int, difference: FloatArray) -> dict[str, str | float]:
    name = THERMAL_ERRORS[i]
    return {"error": name, "difference": float(difference[i]), "unit": ERROR_UNITS[name]}
