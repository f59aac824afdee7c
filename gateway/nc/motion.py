"""Detects axes that report a speed but do not move: the values of such a control are frozen. Pure."""

import math

from drivers.nc import NcSnapshot


class Motion:
    """Checks the snapshots of one control, in order.

    longest_s: an axis may report a speed at an unchanged position for this long. A speed that the control averages over
    a minute outlives the motion by a minute. Snapshots more than a quarter of this apart prove nothing, because a
    machine that repeats its motion returns to the same place.
    """

    def __init__(self, longest_s: float) -> None:
        if not longest_s > 0:
            raise ValueError(f"longest_s = {longest_s!r}: expected more than 0")
        self._longest = longest_s
        self._last: dict[str, tuple[float, float]] = {}
        self._looked_s = -math.inf

    def frozen(self, snapshot: NcSnapshot) -> tuple[str, ...]:
        """Axes that report a speed but do not move, among those with a speed."""
        found = []
        now, gap = snapshot.monotonic_s, snapshot.monotonic_s - self._looked_s
        self._looked_s = now
        for axis, position in snapshot.positions.items():
            last, since = self._last.get(axis, (None, now))
            if position != last or not snapshot.states.get(f"speed_{axis}") or gap > self._longest / 4:
                since = now
            self._last[axis] = position, since
            if now - since >= self._longest:
                found.append(axis)
        return tuple(found)
