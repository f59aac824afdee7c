"""The hall around the machine: a day, a week's weather, a door that opens. A pure function of seed and time."""

import math
from dataclasses import dataclass

import numpy as np

_DAY_S = 86400.0
_WEATHER_STEP_S = 3600.0
_WEATHER_HOURS = 24 * 60
_DOORS_PER_DAY = 3


@dataclass(frozen=True, slots=True)
class Hall:
    """Air temperatures of one moment, degC."""

    low: float
    """At the machine's feet."""
    high: float
    """At the top of the column."""


class Environment:
    """Hall air of a workshop without air conditioning.

    mean 21.5 degC; daily swing ±2.5 K with its maximum at 16 h (halls: ±2 to ±4 K); weather: first-order process with
    2 days' memory and 1 K deviation; 1.2 K between feet and top (1-2 K/m); a door opened about three times a day for
    5-15 min takes the air down by up to 3 K, more at the feet, and the hall recovers with 10 min.

    Parameters
    ----------
    seed: of weather and door
    start_hour: hour of the day at 0 s
    """

    mean = 21.5
    swing = 2.5
    gradient = 1.2
    door_drop = 3.0
    door_recovery_s = 600.0

    def __init__(self, seed: int, start_hour: float = 6.0) -> None:
        draw = np.random.default_rng([seed, 1])
        keep = math.exp(-1 / 48.0)
        noise = draw.normal(0.0, math.sqrt(1 - keep**2), _WEATHER_HOURS)
        weather = np.empty(_WEATHER_HOURS)
        weather[0] = draw.normal()
        for i in range(1, _WEATHER_HOURS):
            weather[i] = keep * weather[i - 1] + noise[i]
        self._weather = weather
        self._start_hour = start_hour
        days = _WEATHER_HOURS // 24
        begins = np.sort(draw.uniform(0.0, days * _DAY_S, _DOORS_PER_DAY * days))
        self._doors = [
            (float(b), float(b + d)) for b, d in zip(begins, draw.uniform(300.0, 900.0, begins.size), strict=True)
        ]

    def at(self, time_s: float) -> Hall:
        """The hall at simulated seconds; after 60 days the weather repeats."""
        hour = time_s / 3600.0 + self._start_hour
        daily = self.swing * math.cos((hour - 16.0) / 24.0 * 2 * math.pi)
        position = time_s / _WEATHER_STEP_S % (_WEATHER_HOURS - 1)
        i = int(position)
        weather = float(self._weather[i] + (self._weather[i + 1] - self._weather[i]) * (position - i))
        base = self.mean + daily + weather
        door = self.door_drop * self._door(time_s)
        return Hall(base - self.gradient / 2 - door, base + self.gradient / 2 - 0.5 * door)

    def _door(self, time_s: float) -> float:
        """0 closed and recovered, towards 1 the longer it is open."""
        level = 0.0
        for begin, end in self._doors:
            if begin > time_s:
                break
            if time_s - end > 8 * self.door_recovery_s:
                continue
            opened = 1 - math.exp(-(min(time_s, end) - begin) / self.door_recovery_s)
            level = max(level, opened * math.exp(-max(0.0, time_s - end) / self.door_recovery_s))
        return level
