"""Makes safe offsets from predicted errors: bounded, slewed, and as configured when nothing is known. Pure."""

from collections.abc import Sequence
from typing import Literal

import numpy as np

from gateway.model.compensation import Offsets, Source, Step
from talc.frame import FloatArray


class Slew:
    """Follows a target within bounds at a bounded rate. Starts from the offsets in force, so it never steps.

    Offsets are coefficients (3, n) of a route (gateway.nc.routes); (3,) counts as (3, 1). Bound and rate hold for the
    sum of the magnitudes of each row, and so at every position.

    Parameters
    ----------
    bound_um: largest magnitude per axis, µm, > 0
    slew_um_per_s: largest rate of change per axis, µm/s, > 0
    when_stale: `zero` ramps to zero, `hold` keeps the last offsets, when there is no usable prediction
    together: whether the rows belong to one cause, as nine errors do: they move in proportion, and the bound is the
        control's, which holds each axis within it wherever the tool is
    period_s: nominal time between steps; a longer pause counts as one period, so that no step is larger and a
        gateway that hung does not catch up in one step
    in_force_um: (3,) or (3, n), what the control reports at start
    now_s: monotonic seconds of that report
    """

    def __init__(
        self,
        bound_um: Sequence[float],
        slew_um_per_s: float,
        when_stale: Literal["zero", "hold"],
        period_s: float,
        in_force_um: FloatArray | Offsets,
        now_s: float,
        *,
        together: bool = False,
    ) -> None:
        self._together = together
        self._bound = np.asarray(bound_um, dtype=float)
        self._rate = slew_um_per_s
        self._when_stale = when_stale
        self._period = period_s
        self._now = _matrix(in_force_um)
        self._time = now_s
        if self._bound.shape != (3,) or not np.all(np.isfinite(self._bound)) or np.any(self._bound <= 0):
            raise ValueError(f"bound_um = {bound_um!r}: expected three positive numbers")
        if not slew_um_per_s > 0:
            raise ValueError(f"slew_um_per_s = {slew_um_per_s!r}: expected more than 0")
        if len(self._now) != 3 or not np.all(np.isfinite(self._now)):
            raise ValueError(f"in_force_um = {in_force_um!r}: expected finite numbers of shape (3,) or (3, n)")

    @property
    def largest_um(self) -> float:
        """The largest offset of any axis at any position."""
        return float(np.abs(self._now).sum(axis=1).max())

    def freeze(self, now_s: float, basis: FloatArray | None = None, source: Source = Source.FROZEN) -> Step:
        """Keep the offsets while time passes: while the NC probes, or cannot follow, its offsets must stand still."""
        self._time = now_s
        return self._step(self._now, source, np.zeros(3, dtype=bool), basis)

    def follow(
        self,
        now_s: float,
        wanted_um: FloatArray | None,
        source: Source = Source.PREDICTION,
        basis: FloatArray | None = None,
    ) -> Step:
        """One step towards `wanted_um`, or towards the configured value if it is None or not finite.

        wanted_um: (3,) or (3, n); basis: (n,) or (3, n), for the machine's position; None: the reference.
        """
        if wanted_um is None or not np.all(np.isfinite(wanted_um)):
            source = Source.NO_MODEL if source is Source.PREDICTION else source
            wanted = np.zeros_like(self._now) if self._when_stale == "zero" else self._now
        else:
            wanted = _matrix(wanted_um)
        target = wanted if self._together else _within(wanted, self._bound)
        reach = self._rate * min(max(0.0, now_s - self._time), self._period)
        way = target - self._now
        if self._together:
            largest = float(np.abs(way).sum(axis=1).max())
            moved = self._now + way * (reach / largest if largest > reach else 1.0)
        else:
            moved = self._now + _within(way, np.full(3, reach))
        # Rounding must not lead past the target, which may be the bound.
        self._now = np.clip(moved, np.minimum(self._now, target), np.maximum(self._now, target))
        self._time = now_s
        size = np.abs(self._shift(wanted, basis)) if self._together else np.abs(wanted).sum(axis=1)
        return self._step(target, source, size > self._bound, basis)

    def _step(self, target: FloatArray, source: Source, cut: np.ndarray, basis: FloatArray | None) -> Step:
        return Step(
            as_offsets(self._at(target, basis)),
            as_offsets(self._at(self._now, basis)),
            source,
            (bool(cut[0]), bool(cut[1]), bool(cut[2])),
            tuple(tuple(row) for row in self._now.tolist()),
        )

    def _at(self, coefficients: FloatArray, basis: FloatArray | None) -> FloatArray:
        shift = self._shift(coefficients, basis)
        return np.clip(shift, -self._bound, self._bound) if self._together else shift

    def _shift(self, coefficients: FloatArray, basis: FloatArray | None) -> FloatArray:
        here = np.eye(self._now.shape[1])[0] if basis is None else basis
        return np.asarray((coefficients * here).sum(axis=1), dtype=np.float64)


def _matrix(values: FloatArray | Offsets) -> FloatArray:
    """(3, n) from (3,) or (3, n)."""
    array = np.asarray(values, dtype=float)
    return array[:, None] if array.ndim == 1 else array


def _within(rows: FloatArray, largest: FloatArray) -> FloatArray:
    """Rows scaled down until the sum of their magnitudes is within `largest`."""
    if rows.shape[1] == 1:  # the same without rounding
        return np.clip(rows, -largest[:, None], largest[:, None])
    size = np.abs(rows).sum(axis=1)
    scale = np.divide(largest, size, out=np.ones(3), where=size > largest)
    scaled: FloatArray = rows * scale[:, None]
    return scaled


def as_offsets(values: FloatArray) -> Offsets:
    """(3,) as plain numbers."""
    x, y, z = (float(v) for v in values)
    return x, y, z
