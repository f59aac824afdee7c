"""From predicted errors to offsets that are safe to send: bounded, slewed, declared when nothing is known. Pure."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from typing import Literal

import numpy as np

from talc.frame import FloatArray

Offsets = tuple[float, float, float]
ZERO: Offsets = (0.0, 0.0, 0.0)


class Source(StrEnum):
    """What the present target rests on."""

    PREDICTION = "prediction"
    STALE = "stale"
    NO_MODEL = "no_model"
    FROZEN = "frozen"
    STOPPED = "stopped"


@dataclass(frozen=True, slots=True)
class Step:
    """One step of the compensation, as stored and published. Micrometres, X Y Z at the tool centre point."""

    target_um: Offsets
    """Wanted, after the bound, before the slew."""
    offsets_um: Offsets
    """What is to be in force from now on."""
    source: Source
    bounded: tuple[bool, bool, bool]
    """Which axes were cut by the bound."""


@dataclass(frozen=True, slots=True)
class Write:
    """One step of the compensation with all that it rests on."""

    time: datetime
    mode: Literal["monitor", "advise", "compensate"]
    step: Step
    k: int | None
    """Grid index of the decision that was used."""
    positions: Mapping[str, float]
    """Axis positions: X Y Z in mm, A C in degrees."""
    written: bool
    """Whether the offsets were sent to the control."""
    read_back_um: Offsets | None
    """What the control reports to have in force after the write; None when nothing was written."""


class Slew:
    """Follows a target at a bounded rate inside bounds. Starts from what the control has in force, so it never steps.

    Parameters
    ----------
    bound_um: largest magnitude per axis, µm, > 0
    slew_um_per_s: largest rate of change per axis, µm/s, > 0
    when_stale: `zero` ramps to zero, `hold` keeps the last offsets, when there is nothing to rest on
    period_s: nominal time between steps; a longer pause counts as two periods at most, so that a gateway that
        hung does not make up for it in one stride
    in_force_um: the offsets the control reports at start
    now_s: monotonic seconds of that report
    """

    def __init__(
        self,
        bound_um: Sequence[float],
        slew_um_per_s: float,
        when_stale: Literal["zero", "hold"],
        period_s: float,
        in_force_um: Offsets,
        now_s: float,
    ) -> None:
        self._bound = np.asarray(bound_um, dtype=float)
        self._rate = slew_um_per_s
        self._when_stale = when_stale
        self._longest = 2 * period_s
        self._offsets = np.asarray(in_force_um, dtype=float)
        self._time = now_s
        if self._bound.shape != (3,) or not np.all(np.isfinite(self._bound)) or np.any(self._bound <= 0):
            raise ValueError(f"bound_um = {bound_um!r}: expected three positive numbers")
        if not slew_um_per_s > 0:
            raise ValueError(f"slew_um_per_s = {slew_um_per_s!r}: expected more than 0")
        if self._offsets.shape != (3,) or not np.all(np.isfinite(self._offsets)):
            raise ValueError(f"in_force_um = {in_force_um!r}: expected three finite numbers")

    @property
    def offsets_um(self) -> Offsets:
        return _offsets(self._offsets)

    def freeze(self, now_s: float) -> Step:
        """Keep the offsets and let time pass: while the NC probes, what it adds must stand still."""
        self._time = now_s
        return Step(self.offsets_um, self.offsets_um, Source.FROZEN, (False, False, False))

    def follow(self, now_s: float, wanted_um: FloatArray | None, source: Source = Source.PREDICTION) -> Step:
        """One step towards `wanted_um` (3,), or towards the declared value when it is None or not finite."""
        if wanted_um is None or not np.all(np.isfinite(wanted_um)):
            source = Source.NO_MODEL if source is Source.PREDICTION else source
            wanted = np.zeros(3) if self._when_stale == "zero" else self._offsets
        else:
            wanted = np.asarray(wanted_um, dtype=float)
        target = np.clip(wanted, -self._bound, self._bound)
        reach = self._rate * min(max(0.0, now_s - self._time), self._longest)
        self._offsets = self._offsets + np.clip(target - self._offsets, -reach, reach)
        self._time = now_s
        cut = np.abs(wanted) > self._bound
        return Step(_offsets(target), self.offsets_um, source, (bool(cut[0]), bool(cut[1]), bool(cut[2])))


def _offsets(values: FloatArray) -> Offsets:
    x, y, z = (float(v) for v in values)
    return x, y, z
