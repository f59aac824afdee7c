"""The target: which thermal errors to cancel now, and whether they are recent enough. Pure."""

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from drivers.base import Quality
from gateway.config.sections import Compensation
from gateway.model.commands import Disarmed, Pause
from gateway.model.compensation import Source
from gateway.nc.unmodelled import LastMeasured
from talc.frame import Decision, FloatArray, Measurement
from talc.names import THERMAL_ERRORS


class Target:
    """Follows decisions. Times are monotonic seconds.

    Parameters
    ----------
    settings: stale_after_s, inputs_stale_after_s and when_stale are used
    last_measured: of errors without a model
    missing_s: inputs of live models without a good value, and since when, as an earlier run left it
    stored: whether what is done can be stored
    paused: the compensation's pause, as an earlier run left it; None: it is not paused
    disarmed: who has disarmed the gateway, likewise
    """

    def __init__(
        self,
        settings: Compensation,
        last_measured: LastMeasured,
        missing_s: Mapping[str, float],
        stored: Callable[[], bool] = lambda: True,
        paused: Pause | None = None,
        disarmed: Disarmed | None = None,
    ) -> None:
        self._settings, self._last_measured, self._stored = settings, last_measured, stored
        self._missing = dict(missing_s)
        self._decision: Decision | None = None
        self._decided_s = 0.0
        self._corrected = np.full(len(THERMAL_ERRORS), np.nan)
        self.paused = paused
        """While set, there is nothing to cancel."""
        self.disarmed = disarmed
        """While set, zero is wanted, whatever `when_stale` says."""

    @property
    def decision(self) -> Decision | None:
        """The latest; None before the first."""
        return self._decision

    @property
    def missing_s(self) -> Mapping[str, float]:
        """Inputs of live models that have no good value, and since when."""
        return self._missing

    def follow(self, decision: Decision, now_s: float) -> None:
        """Compensate by this decision from now on."""
        self._decision, self._decided_s, self._corrected = decision, now_s, decision.corrected
        self._missing = {name: self._missing.get(name, now_s) for name in decision.substituted}

    def renew(self, corrected: FloatArray) -> None:
        """Between two decisions: compensate by these (9,) errors. How old the decision may become is as before."""
        self._corrected = corrected

    def remembered(self, measured_s: Sequence[float], missing_s: Mapping[str, float]) -> None:
        """Times of an earlier run that were not known; -inf: they still are not."""
        self._last_measured.remembered(measured_s)
        self._missing = {
            name: missing_s.get(name, since) if math.isinf(since) else since for name, since in self._missing.items()
        }

    def measured(self, measurement: Measurement, now_s: float) -> None:
        self._last_measured.measured(measurement, now_s)

    def errors(self, quality: Quality, now_s: float) -> tuple[FloatArray | None, Source]:
        """(9,) errors to cancel, zero for unknown ones, and their source; None: there is nothing to cancel them by.

        quality: of the control's snapshot
        """
        settings, decision = self._settings, self._decision
        if self.disarmed is not None:
            return np.zeros(len(THERMAL_ERRORS)), Source.DISARMED
        if self.paused is not None:
            return None, Source.PAUSED
        if decision is None:
            return None, Source.NO_MODEL
        if now_s - self._decided_s > settings.stale_after_s or quality is not Quality.GOOD:
            return None, Source.STALE
        if not self._stored():
            return None, Source.NOT_STORED
        if any(now_s - since > settings.inputs_stale_after_s for since in self._missing.values()):
            return None, Source.INPUTS_STALE
        corrected = self._corrected
        if settings.when_stale == "zero":
            corrected = np.where(self._last_measured.outdated(decision, now_s), np.nan, corrected)
        if not np.any(np.isfinite(corrected)):
            return None, Source.NO_MODEL
        # An error without an estimate is not compensated; the others still are.
        return np.nan_to_num(corrected), Source.PREDICTION
