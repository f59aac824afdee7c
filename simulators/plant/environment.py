"""The hall: daily cycle, weather, vertical gradient, door. Every draw depends only on the seed and the date."""

import math
from dataclasses import dataclass
from datetime import datetime, timedelta

import numpy as np

from simulators.plant.body import FloatArray
from simulators.plant.joined import ZONES

_WEATHER_STEP_S = 600.0
_DAY_S = 86400.0
_FORGOTTEN = 10.0
"""After this many recovery times, less than a millikelvin of the effect of an open door is left."""
_HEIGHT_M = {"left": 1.0, "right": 1.0, "front": 1.0, "rear": 1.3, "high": 2.6, "ground": 0.0}
"""Height of each zone's air beside the machine above the hall's floor (assumed: panels' middle, portal's top)."""
_DOOR_SHARE = {"left": 1.0, "right": 0.5, "front": 0.9, "rear": 0.4, "high": 0.3, "ground": 0.0}
"""Each zone's share of the drop: the door is at the front left, cold air stays low, machine and cabinet stand before
the rear (assumed)."""
_WORKING_S, _OPEN_S, _FALL_S = (6 * 3600.0, 20 * 3600.0), (120.0, 900.0), 180.0
"""Times of day between which the door is opened; for how long, least and longest; the drop's time constant
(assumed)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Environment:
    """A hall without air conditioning, within 18-28 degC most of the year; docs/plant.md states the assumptions."""

    mean_degC: float = 23.0  # noqa: N815
    daily_amplitude_K: float = 2.0  # noqa: N815
    """Half the daily swing; warmest at 16 h."""
    weather_sigma_K: float = 0.6  # noqa: N815
    """Standard deviation of the slow AR(1) process."""
    weather_tau_s: float = 30 * 3600.0
    """Weather changes over a day or so."""
    gradient_K_m: float = 1.3  # noqa: N815
    """Vertical gradient; a third more at noon, a third less at night."""
    door_drop_K: float = 3.0  # noqa: N815
    door_openings_per_day: float = 6.0
    door_recovery_s: float = 1200.0


class Hall:
    """Zone temperatures at any time since `start_utc`, or before it (negative seconds down to `-before_s`)."""

    def __init__(self, environment: Environment, seed: int, start_utc: datetime, before_s: float) -> None:
        self.environment, self._start, self._before_s = environment, start_utc, before_s
        self._seed = seed
        self._midnight = start_utc.replace(hour=0, minute=0, second=0, microsecond=0)
        self._start_of_day_s = (start_utc - self._midnight).total_seconds()
        self._generator = np.random.default_rng([seed, 1])
        self._weather = [float(self._generator.standard_normal())]
        self._recent: tuple[int | None, list[tuple[float, float]]] = (None, [])
        self._doors: dict[int, list[tuple[float, float]]] = {}
        self._height = np.array([_HEIGHT_M[zone] for zone in ZONES])
        self._share = np.array([_DOOR_SHARE[zone] for zone in ZONES])

    def zones(self, time_s: float) -> FloatArray:
        """(z,) degC in the order of ZONES."""
        e = self.environment
        day_s = time_s + self._start_of_day_s
        wave = math.cos(2 * math.pi * (day_s / _DAY_S - 16 / 24))
        air = e.mean_degC + e.daily_amplitude_K * wave + e.weather_sigma_K * self._weather_at(time_s)
        gradient = e.gradient_K_m * (1 + wave / 3)
        temperatures: FloatArray = air + gradient * (self._height - 1.0) - self._share * self._door(day_s)
        temperatures[ZONES.index("ground")] = e.mean_degC - 3.0
        return temperatures

    def _weather_at(self, time_s: float) -> float:
        position = max(time_s + self._before_s, 0.0) / _WEATHER_STEP_S
        k = int(position)
        keep = math.exp(-_WEATHER_STEP_S / self.environment.weather_tau_s)
        while len(self._weather) < k + 2:
            draw = float(self._generator.standard_normal())
            self._weather.append(keep * self._weather[-1] + math.sqrt(1 - keep**2) * draw)
        return self._weather[k] + (position - k) * (self._weather[k + 1] - self._weather[k])

    def _openings(self, day: int) -> list[tuple[float, float]]:
        """(opened, closed) in seconds since the first midnight; working hours 6 to 20."""
        if day not in self._doors:
            ordinal = (self._midnight + timedelta(days=day)).toordinal()
            generator = np.random.default_rng([self._seed, 2, ordinal])
            count = int(generator.poisson(self.environment.door_openings_per_day))
            opened = np.sort(generator.uniform(*_WORKING_S, count)) + day * _DAY_S
            lasting = generator.uniform(*_OPEN_S, count)
            self._doors[day] = [(float(o), float(o + d)) for o, d in zip(opened, lasting, strict=True)]
        return self._doors[day]

    def _door(self, day_s: float) -> float:
        """Drop in K: it tends to the full drop with a time constant of 3 min while the door is open, then back with
        `door_recovery_s`."""
        drop, hour = 0.0, math.floor(day_s / 3600.0)
        if self._recent[0] != hour:
            day, long_ago = math.floor(day_s / _DAY_S), hour * 3600.0 - _FORGOTTEN * self.environment.door_recovery_s
            near = self._openings(day - 1) + self._openings(day)
            self._recent = hour, [(o, c) for o, c in near if c > long_ago and o < (hour + 1) * 3600.0]
        for opened, closed in self._recent[1]:
            if day_s > opened:
                reached = 1 - math.exp(-(min(day_s, closed) - opened) / _FALL_S)
                drop = max(drop, reached * math.exp(-max(day_s - closed, 0.0) / self.environment.door_recovery_s))
        return drop * self.environment.door_drop_K
