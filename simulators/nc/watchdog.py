"""The watchdog on the NC as in TALC_START: silence ramps the offsets to zero, or holds them. Knows no protocol.

What a real control's program does in each interpolation cycle it does at any time step: it also copies each beat, so
that a gateway sees that it runs.

state     leaves when                                          to
off       the beat changes                                     alive
alive     no other beat for R95 seconds, or the owner leaves   silent
silent    the beat changes                                     alive
"""

import math
from dataclasses import dataclass
from enum import IntEnum

R_OWNER, R_BEAT, R_SILENCE, R_WATCH, R_RAMP, R_SLOPE_RAMP = 93, 94, 95, 96, 97, 98
R_ECHO = 68
"""The beat that has passed through the whole program."""


class WatchState(IntEnum):
    """Value of the state parameter R96."""

    OFF = 0
    ALIVE = 1
    SILENT = 2


@dataclass(frozen=True, slots=True)
class Logged:
    """Offsets as set by the gateway (`ramped` false) or by the watchdog, in the control's sign, mm."""

    time_s: float
    values_mm: tuple[float, float, float]
    ramped: bool


class Watchdog:
    """Advances with time; works on the control's own R-parameters and offsets.

    Parameters
    ----------
    r: all R-parameters
    offsets: every (list, first index) whose three values, mm, are offsets and go to zero on silence
    slopes: every (list, unit) whose values are slopes and go to zero too; unit: how many of theirs make 1 mm/mm
    echo: R-parameter of the copied beat

    Attributes
    ----------
    runs: whether its program has been started since power on, and nobody has ended it
    """

    def __init__(
        self,
        r: list[float],
        offsets: tuple[tuple[list[float], int], ...],
        slopes: tuple[tuple[list[float], float], ...] = (),
        echo: int = R_ECHO,
    ) -> None:
        self._r, self._offsets, self._slopes, self._echo = r, offsets, slopes, echo
        self.runs = True
        self._heard_s = self._now_s = 0.0

    @property
    def silent_from_s(self) -> float:
        """When it finds the gateway silent unless another beat comes; infinite while no gateway is alive."""
        if not self.runs or self._r[R_WATCH] != WatchState.ALIVE or self._r[R_OWNER] <= 0:
            return math.inf
        return self._heard_s + self._r[R_SILENCE]

    def beat(self, now_s: float) -> None:
        """R94 has changed."""
        self.advance(now_s)
        if not self.runs:
            return
        self._heard_s = now_s
        if self._r[R_OWNER] > 0:
            self._r[R_WATCH] = WatchState.ALIVE
            self._r[self._echo] = self._r[R_BEAT]

    def advance(self, now_s: float) -> None:
        """Let time pass; the result is exact however rarely it is called."""
        silent_from = self._now_s
        if not self.runs:
            self._now_s = max(self._now_s, now_s)
            return
        if self._r[R_WATCH] == WatchState.ALIVE:
            silent_from = max(self._now_s, self._heard_s + self._r[R_SILENCE]) if self._r[R_OWNER] > 0 else now_s
            if now_s >= silent_from:
                self._r[R_WATCH] = WatchState.SILENT
        if self._r[R_WATCH] == WatchState.SILENT:
            passed = max(0.0, now_s - silent_from)
            for values, first in self._offsets:
                for index in range(first, first + 3):
                    values[index] = _towards_zero(values[index], passed * self._r[R_RAMP])
            for values, unit in self._slopes:
                values[:] = [_towards_zero(value, passed * self._r[R_SLOPE_RAMP] * unit) for value in values]
        self._now_s = max(self._now_s, now_s)


def _towards_zero(value: float, reach: float) -> float:
    return value - min(max(value, -reach), reach)
