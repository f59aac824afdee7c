"""Which sensor a hand warms: on drawn sensors, and where nothing may be named."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest

from gateway.commissioning.naming.warmed import Track, warmed

KEPT = 120
HELD_S = 45.0
"""After which the hand lets go and begins again."""
TIMES = np.arange(40.0)


@dataclass(frozen=True, slots=True)
class Hall:
    """Sensors as they hang in a hall. Each has its own noise, drift, time constant and contact with the hand."""

    sensors: int
    drift_k_per_min: float = 0.3
    neighbour: float = 0.3
    """The part of the hand's heat that a neighbour gets at most."""
    step_k: float | None = None
    """Resolution; None: drawn for each of none, 0.01 and 0.1 K."""


@dataclass(frozen=True, slots=True)
class Found:
    """One that was named."""

    right: bool
    after_s: float
    """Since the hand was laid on it."""


def session(hall: Hall, seed: int) -> Iterator[Found]:
    """Every sensor once, in any order."""
    draw, n = np.random.default_rng(seed), hall.sensors
    noise = draw.uniform(0.01, 0.15, n)
    step = draw.choice([1e-9, 0.01, 0.1], n) if hall.step_k is None else np.full(n, hall.step_k)
    base, slope = draw.uniform(18.0, 28.0, n), draw.uniform(0.0, hall.drift_k_per_min, n) / 60.0
    lag_s, gain_k = draw.uniform(5.0, 25.0, n), draw.uniform(3.0, 9.0, n)
    warm, t_s = np.zeros(n), 0.0
    for sensor in draw.permutation(n):
        begun_s, read = t_s + draw.uniform(6.0, 12.0), list[np.ndarray]()
        heat = np.zeros(n)
        heat[sensor] = 1.0
        for beside in {sensor - 1, sensor + 1} & set(range(n)):
            heat[beside] = draw.uniform(0.0, hall.neighbour)
        while True:
            t_s += 1.0
            held = t_s >= begun_s and (t_s - begun_s) % (2.0 * HELD_S) < HELD_S
            warm += (heat * gain_k * held - warm) / lag_s
            values = base + slope * t_s + warm + noise * draw.standard_normal(n)
            read = [*read[1 - KEPT :], np.round(values / step) * step]
            times = np.arange(len(read), dtype=np.float64)
            seen = warmed(
                {str(i): Track(times, each.astype(np.float64), "degC") for i, each in enumerate(np.array(read).T)}
            )
            if seen is not None and seen.clear:
                yield Found(int(seen.channel) == sensor, t_s - begun_s)
                break


def track(rise: float, unit: str = "degC", noise: float = 0.01, seed: int = 0) -> Track:
    """A value that has risen so far within the last 20 s."""
    ramp = np.clip((TIMES - 20.0) / 15.0, 0.0, 1.0)
    return Track(TIMES, 20.0 + rise * ramp + noise * np.random.default_rng(seed).standard_normal(TIMES.size), unit)


@pytest.mark.parametrize("hall", [Hall(sensors=8), Hall(sensors=3, step_k=0.1)])
def test_each_drawn_sensor_is_found_and_no_other(hall: Hall) -> None:
    found = [each for seed in range(2) for each in session(hall, seed)]
    assert [each for each in found if not each.right] == []
    assert len(found) == 2 * hall.sensors
    assert min(each.after_s for each in found) > 0.0, "never before the hand is there"


def test_what_all_do_is_no_hand_and_two_that_rise_alike_are_told_together() -> None:
    assert not warmed({str(i): track(2.0 + 0.1 * i, seed=i) for i in range(6)}).rising  # type: ignore[union-attr]
    quiet = {str(i): track(0.0, seed=i) for i in range(4)}
    both = warmed({**quiet, "one": track(2.0, seed=8), "other": track(1.6, seed=9)})
    assert both is not None
    assert (both.channel, both.second, both.rising, both.clear) == ("one", "other", True, False)
    alone = warmed({**quiet, "one": track(2.0, seed=8), "other": track(0.5, seed=9)})
    assert alone is not None
    assert alone.clear
    assert alone.rise == pytest.approx(2.0, abs=0.1)


def test_noise_is_no_rise_and_one_that_cools_does_not_make_the_other_rise() -> None:
    for seed in range(20):
        noisy = warmed({"one": track(0.0, noise=0.5, seed=seed), "other": track(-3.0, seed=seed + 50)})
        assert noisy is None or not noisy.rising


def test_a_gap_moves_in_either_direction_by_its_own_noise() -> None:
    seen = warmed({"gap": track(-8.0, "µm", noise=0.1), "bed": track(0.1), "column": track(0.0, seed=3)})
    assert seen is not None
    assert (seen.channel, seen.clear) == ("gap", True)


def test_one_step_of_a_quiet_number_is_a_rise() -> None:
    stepped = Track(TIMES, np.where(TIMES < 25.0, 20.0, 23.0), "degC")
    seen = warmed({"bed": stepped, "column": Track(TIMES, np.full(TIMES.size, 21.0), "degC")})
    assert seen is not None
    assert (seen.channel, seen.clear) == ("bed", True)


def test_too_few_values_say_nothing() -> None:
    few = Track(TIMES[:9], np.linspace(20.0, 30.0, 9), "degC")
    assert warmed({"bed": few}) is None
    assert warmed({}) is None
