"""Rests of busy units: how long a unit is left alone before it is asked again."""

_FIRST_S = 0.05
"""The first rest."""
_NEXT_S = 0.1
"""Each one after it, until the unit answers."""


class Rests:
    """The rests of the units on one bus."""

    def __init__(self) -> None:
        self._until_s: dict[int, float] = {}

    def was_busy(self, unit: int, now_s: float) -> None:
        """The unit has just answered that it is busy. now_s: monotonic"""
        self._until_s[unit] = now_s + (_NEXT_S if unit in self._until_s else _FIRST_S)

    def answered(self, unit: int) -> None:
        """The unit is not busy any more, or is asked something new."""
        self._until_s.pop(unit, None)

    def left_s(self, unit: int, now_s: float) -> float:
        """How much longer it rests; not above 0: it may be asked."""
        return self._until_s.get(unit, now_s) - now_s
