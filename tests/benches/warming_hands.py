"""Somebody warms one drawn sensor after the other: what `talc-gateway name` takes for the warmed one.

python -m tests.benches.warming_hands 1000
"""

import sys
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gateway.commissioning.naming.warmed import Track, warmed

_KEPT = 120
_HELD_S = 45.0
"""After which the hand lets go and begins again."""


@dataclass(frozen=True, slots=True)
class Hall:
    """Sensors as they hang in a hall. Each has its own noise, drift, time constant and contact with the hand."""

    sensors: int = 29
    drift_k_per_min: float = 0.3
    neighbour: float = 0.3
    """How much of the hand's heat a neighbour gets at most."""
    step_k: float | None = None
    """Resolution; None: drawn for each of none, 0.01 and 0.1 K."""
    period_s: float = 1.0


@dataclass(frozen=True, slots=True)
class Found:
    """One that was named."""

    right: bool
    after_s: float
    """Since the hand was laid on it."""
    at_s: float


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
            t_s += hall.period_s
            held = t_s >= begun_s and (t_s - begun_s) % (2.0 * _HELD_S) < _HELD_S
            warm += hall.period_s * (heat * gain_k * held - warm) / lag_s
            values = base + slope * t_s + warm + noise * draw.standard_normal(n)
            read = [*read[1 - _KEPT :], np.round(values / step) * step]
            times = np.arange(len(read), dtype=np.float64) * hall.period_s
            seen = warmed(
                {str(i): Track(times, each.astype(np.float64), "degC") for i, each in enumerate(np.array(read).T)}
            )
            if seen is not None and seen.clear:
                yield Found(int(seen.channel) == sensor, t_s - begun_s, t_s)
                break


def main(seeds: int) -> None:
    """Print how often it was wrong, and how long it took, in halls of several kinds."""
    for what, hall in {
        "29 sensors": Hall(),
        "neighbours get up to 45 %": Hall(neighbour=0.45),
        "drifts of up to 1 K/min": Hall(drift_k_per_min=1.0),
        "steps of 0.1 K": Hall(step_k=0.1),
        "one module of 6": Hall(sensors=6),
        "two": Hall(sensors=2),
        "read every 2 s": Hall(period_s=2.0),
    }.items():
        runs = [list(session(hall, seed)) for seed in range(seeds)]
        found = [each for run in runs for each in run]
        after_s = np.array([each.after_s for each in found])
        print(
            f"{what}: {sum(not each.right for each in found)} of {len(found)} wrong; "
            f"{np.median(after_s):.0f} s, 99 % within {np.quantile(after_s, 0.99):.0f} s; "
            f"all within {np.median([run[-1].at_s for run in runs]):.0f} s, "
            f"at most {max(run[-1].at_s for run in runs):.0f} s",
            flush=True,
        )


if __name__ == "__main__":
    main(int(sys.argv[1]))
