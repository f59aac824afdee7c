"""Whether an axis that reports a speed also moves: a control whose values stand still looks healthy otherwise. Pure."""

from drivers.nc import NcSnapshot


class Motion:
    """Judges one control's snapshots, in their order.

    longest_s: an axis may report a speed at an unchanged position for so long. A speed that the control forms as a
    mean over a minute outlives the motion by a minute.
    """

    def __init__(self, longest_s: float) -> None:
        if not longest_s > 0:
            raise ValueError(f"longest_s = {longest_s!r}: expected more than 0")
        self._longest = longest_s
        self._last: dict[str, tuple[float, float]] = {}

    def frozen(self, snapshot: NcSnapshot) -> tuple[str, ...]:
        """Axes that do not move although they report a speed; only those whose speed is read."""
        found = []
        for axis, position in snapshot.positions.items():
            last, since = self._last.get(axis, (None, snapshot.monotonic_s))
            if position != last or not snapshot.states.get(f"speed_{axis}"):
                since = snapshot.monotonic_s
            self._last[axis] = position, since
            if snapshot.monotonic_s - since >= self._longest:
                found.append(axis)
        return tuple(found)
