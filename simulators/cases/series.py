"""Series of drives on a grid. Pure functions of their arguments: the same seed gives the same series."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from simulators.plant import Environment, MachineDrive

HIGHEST = MachineDrive(speed_x=30000, speed_y=30000, speed_z=30000, speed_a=40, speed_c=1200, spindle_speed=18000)
"""The table machine's limits, mm/min and 1/min."""
DRAWN_AXES = ("speed_x", "speed_y", "speed_a", "speed_c", "spindle_speed")

Axis = Literal["speed_x", "speed_y", "speed_z", "speed_a", "speed_c", "spindle_speed"]

SEASONS = {
    "winter": Environment(mean_degC=22.0, door_drop_K=3.5),
    "spring": Environment(),
    "summer": Environment(mean_degC=24.5, daily_amplitude_K=3.0, door_drop_K=1.0),
}
"""Halls at 18-28 degC at working height, except near the open door, with a daily swing of +-2 to 3 K. In summer the air
from the door is little colder than the hall's (choice)."""


LONG_TERM_H = {"winter": 196, "spring": 72, "summer": 72}
"""Z22's hours. The order of the seasons is our choice."""


@dataclass(frozen=True, slots=True)
class Stretch:
    """An uninterrupted recording: one plant, one hall."""

    name: str
    environment: Environment
    drives: tuple[MachineDrive, ...]


def random_axes(seed: int, steps: int, *, wet_share: float = 0.3) -> tuple[MachineDrive, ...]:
    """A new random load in each row, on one axis or the spindle at a time (Z22 §5), or no load.

    Speeds are uniform up to HIGHEST; cutting fluid is on in `wet_share` of the rows (choice: the paper gives no
    distributions). Z never moves: it gives only its standby heat.

    ValueError: a share outside 0 to 1 or a negative number of steps.
    """
    if not 0 <= wet_share <= 1:
        raise ValueError(f"wet_share = {wet_share}: expected 0 to 1")
    if steps < 0:
        raise ValueError(f"steps = {steps}: expected 0 or more")
    draw = np.random.default_rng([seed, 5])
    drives = []
    for _ in range(steps):
        rest = MachineDrive(coolant_on=bool(draw.random() < wet_share))
        which, part = int(draw.integers(len(DRAWN_AXES) + 1)), float(draw.uniform())
        drives.append(_with(rest, DRAWN_AXES[which], part) if which < len(DRAWN_AXES) else rest)
    return tuple(drives)


def long_term(seed: int, *, step_s: float = 300.0) -> tuple[Stretch, ...]:
    """Z22's 196 + 72 + 72 h in three seasons."""
    return tuple(
        Stretch(name, SEASONS[name], random_axes(seed + k, round(length * 3600 / step_s)))
        for k, (name, length) in enumerate(LONG_TERM_H.items())
    )


def warm_up_and_cool_down(
    axis: Axis, *, share: float = 0.75, warm_h: float = 4.0, cool_h: float = 4.0, step_s: float = 300.0
) -> tuple[MachineDrive, ...]:
    """One axis or the spindle at a constant share of its highest speed, then at rest, as in ISO 230-3's tests.

    ValueError: a share outside 0 to 1.
    """
    if not 0 <= share <= 1:
        raise ValueError(f"share = {share}: expected 0 to 1")
    warm = _with(MachineDrive(), axis, share)
    return (warm,) * round(warm_h * 3600 / step_s) + (MachineDrive(),) * round(cool_h * 3600 / step_s)


def _with(rest: MachineDrive, axis: str, part: float) -> MachineDrive:
    """`rest`, with one speed at a fraction of its highest."""
    match axis:
        case "speed_x":
            return replace(rest, speed_x=part * HIGHEST.speed_x)
        case "speed_y":
            return replace(rest, speed_y=part * HIGHEST.speed_y)
        case "speed_z":
            return replace(rest, speed_z=part * HIGHEST.speed_z)
        case "speed_a":
            return replace(rest, speed_a=part * HIGHEST.speed_a)
        case "speed_c":
            return replace(rest, speed_c=part * HIGHEST.speed_c)
        case "spindle_speed":
            return replace(rest, spindle_speed=part * HIGHEST.spindle_speed)
        case _:
            raise ValueError(f"axis {axis!r}: expected one of {', '.join(DRAWN_AXES)} or speed_z")
