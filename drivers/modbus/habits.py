"""Decides whether a unit's missing answers are late or lost: it waits for late ones, and asks again for lost ones."""

from dataclasses import dataclass

_NEWEST = 1 / 4
"""Weight of the newest missing answer."""
_LATE = 0.5
"""Above this share they count as late."""
_UNKNOWN = 0.4
"""What it is at first."""
_LOST = 0.2
"""Below this share they count as lost."""
_LONGER = 1.25
"""Factor of the time that late answers of a unit usually take: it is waited for that long."""


@dataclass(slots=True)
class _Habit:
    late: float = _UNKNOWN
    """Share of the missing answers that came in the end."""
    took_s: float = 0.0
    """How long they took."""


class Habits:
    """Learnt of each unit. To a unit that is busy, each repeated request is one more that it has to answer."""

    def __init__(self) -> None:
        self._of: dict[int, _Habit] = {}

    def was_late(self, unit: int, took_s: float | None = None) -> None:
        """A missing answer has come.

        took_s: how long after its request, if that is known
        """
        habit = self._of.setdefault(unit, _Habit())
        habit.late += _NEWEST * (1 - habit.late)
        if took_s is not None:
            habit.took_s = max(took_s, habit.took_s + _NEWEST * (took_s - habit.took_s))

    def was_lost(self, unit: int) -> None:
        """A missing answer has not come."""
        habit = self._of.setdefault(unit, _Habit())
        habit.late -= _NEWEST * habit.late

    def patience_s(self, unit: int) -> float:
        """For how long after a request its late answer is waited for, before the request is sent again; 0: not."""
        habit = self._of.get(unit)
        return 0.0 if habit is None or habit.late <= _LATE else _LONGER * habit.took_s

    def loses(self, unit: int) -> bool:
        """Whether its missing answers are usually lost, so that waiting longer for one is of no use."""
        habit = self._of.get(unit)
        return habit is not None and habit.late < _LOST
