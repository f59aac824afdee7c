"""What an input measures, by the unit of its latest reading."""

from collections.abc import Collection

from drivers.base import Clock
from gateway.acquisition.board import Board

_TEMPERATURE = "degC"
_LOADS = frozenset({"1/min", "mm/s", "m/s", "%", "W", "kW", "A", "Nm"})
"""Units of what heats a machine: speeds, shares of a rated load, powers, currents, torques."""


class Quantities:
    """Tells temperatures from loads.

    Parameters
    ----------
    channels: inputs that are read from devices; the others are machine states
    board: their latest readings
    """

    def __init__(self, channels: Collection[str], board: Board, clock: Clock) -> None:
        self._channels, self._board, self._clock = frozenset(channels), board, clock

    def is_temperature(self, name: str) -> bool:
        """Whether it is a temperature; not while nothing has been read."""
        return self._unit(name) == _TEMPERATURE

    def is_load(self, name: str) -> bool:
        """A machine state, or a channel that tells a speed, power, current, torque or share of a load."""
        return name not in self._channels or self._unit(name) in _LOADS

    def _unit(self, name: str) -> str | None:
        aged = self._board.latest(name, self._clock.monotonic()) if name in self._channels else None
        return None if aged is None else aged.reading.unit
