"""Load cases A to D after B19: the C axis turns, and cutting fluid is switched on and off."""

from collections.abc import Callable
from itertools import cycle
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from simulators.cases.series import HIGHEST, SEASONS, Stretch
from simulators.plant import MachineDrive

Letter = Literal["A", "B", "C", "D"]

STAND_SHARE = 0.25
SPEED_HOLD_H = (0.5, 3.0)
FLUID_HOLD_H = (2.0, 8.0)
_SPEEDS_HOLD_H = {"A": (4.0, 8.0), "B": (2.0, 4.0), "C": (0.5, 2.0), "D": (0.5, 2.0)}
SHIFT_H = 16.0
"""Working hours of a day in case D, from the start of the series."""


def table_and_fluid(letter: Letter, seed: int, *, hours: float = 120.0, step_s: float = 300.0) -> Stretch:
    """One of four load cases under which boundary conditions change suddenly, in the spring hall.

    A: blocks of 0.5-3 h at a random C speed up to 1200 1/min, a quarter of them at rest; always dry.
    B: the same speeds; cutting fluid always on.
    C: the same speeds; cutting fluid changes between on and off each 2-8 h.
    D: as C for 16 h a day; for the rest of the day everything is off, but the machine is powered.

    B19 varies C speed and cutting fluid in four load cases; lengths, speeds and the differences between them are our
    choice.
    The same seed gives A to D the same speeds (D: while it works). ValueError: another letter, or hours not positive.
    """
    if letter not in get_args(Letter):
        raise ValueError(f"letter {letter!r}: expected A, B, C or D")
    if not hours > 0:
        raise ValueError(f"hours = {hours}: expected more than 0")
    steps = round(hours * 3600 / step_s)
    speeds = np.random.default_rng([seed, 6])
    fluid = np.random.default_rng([seed, 7])
    speed = _held(
        steps, step_s, SPEED_HOLD_H, speeds, lambda draw: float(draw.uniform(0.1, 1.0) * (draw.random() >= STAND_SHARE))
    )
    on_off = cycle((1.0, 0.0) if fluid.random() < 0.5 else (0.0, 1.0))
    changing = _held(steps, step_s, FLUID_HOLD_H, fluid, lambda _: next(on_off))
    wet = {"A": np.zeros(steps), "B": np.ones(steps)}.get(letter, changing)
    hour = np.arange(steps) * step_s / 3600 % 24
    works = hour < SHIFT_H if letter == "D" else np.ones(steps, dtype=np.bool_)
    drives = tuple(
        MachineDrive(speed_c=part * HIGHEST.speed_c, coolant_on=bool(on)) if working else MachineDrive()
        for part, on, working in zip(speed.tolist(), wet.tolist(), works.tolist(), strict=True)
    )
    return Stretch(letter, SEASONS["spring"], drives)


def table_speeds(letter: Letter, seed: int, *, hours: float, step_s: float = 300.0) -> Stretch:
    """One of B19's four load cases: the speed of C varies in all of them, and only in D cutting fluid is switched.

    A: each speed lasts 4 to 8 h; B: 2 to 4 h; C: 0.5 to 2 h; D: as C, with fluid on or off for 2 to 8 h. How the speeds
    of the paper's cases differ is not known: lengths and speeds are our choice. In the spring hall. ValueError: another
    letter, or hours not positive.
    """
    if letter not in get_args(Letter):
        raise ValueError(f"letter {letter!r}: expected A, B, C or D")
    if not hours > 0:
        raise ValueError(f"hours = {hours}: expected more than 0")
    steps = round(hours * 3600 / step_s)
    speeds, fluid = np.random.default_rng([seed, 8]), np.random.default_rng([seed, 9])
    speed = _held(steps, step_s, _SPEEDS_HOLD_H[letter], speeds, lambda draw: float(draw.uniform(0.0, 1.0)))
    on_off = cycle((1.0, 0.0))
    wet = _held(steps, step_s, FLUID_HOLD_H, fluid, lambda _: next(on_off)) if letter == "D" else np.zeros(steps)
    drives = tuple(
        MachineDrive(speed_c=part * HIGHEST.speed_c, coolant_on=bool(on))
        for part, on in zip(speed.tolist(), wet.tolist(), strict=True)
    )
    return Stretch(letter, SEASONS["spring"], drives)


def _held(
    steps: int,
    step_s: float,
    hold_h: tuple[float, float],
    draw: np.random.Generator,
    value: Callable[[np.random.Generator], float],
) -> NDArray[np.float64]:
    """(steps,) values, each of which lasts for a random time."""
    series, k = np.empty(steps), 0
    while k < steps:
        hold = max(1, round(draw.uniform(*hold_h) * 3600 / step_s))
        series[k : k + hold] = value(draw)
        k += hold
    return series
