"""Offset and exchanged sensors on simulated machines: how often they are found, and how many alarms are false.

Sixteen varied machines run for twelve days each, under a shop's day and under random loads of single axes. False
alarms: the gateway's own watch over all days, learning and reporting as in service. Detection: a window entirely with
the fault, after a given number of days of learning; faults and windows are drawn at random.
"""

import asyncio
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field

import numpy as np

from benchmarks.data import machine_days
from benchmarks.rows import BenchRow
from gateway.control.sensor_watch import SensorWatch
from gateway.model.events import EventReported, GatewayEvent
from gateway.runtime.clocks import RealClock
from talc.frame import BoolArray, EventKind, FloatArray, Frame
from talc.sensor_check import judge, rows_needed
from talc.sensor_model import SensorModel, learn
from talc.settings import SensorCheckSettings

_DAY, DAYS = 288, 12
SEEDS = range(200, 216)
_LEARNT = (1, 2, 4, 8)
_OFFSETS_K = (0.3, 0.5, 1.0, 2.0, 3.0)
DRAWS = 5
"""Windows per machine and days of learning, with one fault of each size and as many exchanges."""
_SETTINGS = SensorCheckSettings()
_SENSORS, _STEP_S = 29, 300.0


@dataclass(slots=True)
class SensorOutcome:
    """One machine."""

    told: list[str] = field(default_factory=list)
    watched_days: float = 0.0
    found: dict[tuple[int, float], int] = field(default_factory=dict)
    """From days learnt and offset (0: an exchange) to how many of `DRAWS` were found and named."""
    smallest: dict[int, list[float]] = field(default_factory=dict)
    alike: list[tuple[str, str]] = field(default_factory=list)
    """After eight days, one entry per pair and window."""
    windows: int = 0
    loaded: int = 0
    """Windows after eight days in which the loads were taken in."""


class _SuspectNotes:
    def __init__(self, outcome: SensorOutcome) -> None:
        self._outcome = outcome

    def __call__(self, event: GatewayEvent) -> None:
        if isinstance(event, EventReported) and event.event.kind is EventKind.SENSOR_SUSPECT:
            self._outcome.told.append(f"step {event.k}: {event.event.text}")


async def _learn(
    names: Sequence[str],
    inputs: FloatArray,
    valid: BoolArray,
    settings: SensorCheckSettings,
    loads: Sequence[str],
    step_s: float,
) -> SensorModel | None:
    return learn(names, inputs, valid, settings, loads, step_s)


async def _watch(names: tuple[str, ...], x: FloatArray, outcome: SensorOutcome) -> None:
    heard, own = _SuspectNotes(outcome), names[:_SENSORS].__contains__
    watching = SensorWatch(
        names, _SETTINGS, _STEP_S, own, heard, RealClock(), None, _learn, is_load=lambda name: not own(name)
    )
    valid = np.ones(len(names), np.bool_)
    for k, row in enumerate(x):
        watching.follow(Frame(k, row, valid))
        if k % 12 == 0:
            await watching.look()
    outcome.watched_days = len(x) / _DAY - 1.0


def _detect(names: tuple[str, ...], x: FloatArray, seed: int, outcome: SensorOutcome) -> None:
    draw = np.random.default_rng([seed, 31])
    good, loads = np.ones(x.shape, np.bool_), names[_SENSORS:]
    for days in _LEARNT:
        model = learn(names, x[: days * _DAY], good[: days * _DAY], _SETTINGS, loads, _STEP_S)
        if model is None:
            raise RuntimeError(f"nothing was learnt from {days} days")
        n = _SETTINGS.window_steps + model.change_steps
        for _ in range(DRAWS):
            end = int(draw.integers(days * _DAY + n, len(x)))
            window = x[max(0, end - rows_needed(model, _SETTINGS)) : end]
            healthy = judge(model, names, window, good[: len(window)], _SETTINGS)
            outcome.smallest.setdefault(days, []).extend(healthy.smallest_offset_K.values())
            if days == _LEARNT[-1]:
                outcome.alike += healthy.alike
                outcome.windows += 1
                outcome.loaded += bool(healthy.loads)
            for size in _OFFSETS_K:
                i, sign = int(draw.integers(_SENSORS)), float(draw.choice([-1.0, 1.0]))
                off = window.copy()
                off[:, i] += sign * size
                first = judge(model, names, off, good[: len(window)], _SETTINGS).findings[:1]
                hit = any(f.kind == "offset" and names[i] in f.inputs + f.alternatives for f in first)
                outcome.found[days, size] = outcome.found.get((days, size), 0) + hit
            i, j = (int(v) for v in draw.choice(_SENSORS, 2, replace=False))
            exchanged = window.copy()
            exchanged[:, [i, j]] = exchanged[:, [j, i]]
            first = judge(model, names, exchanged, good[: len(window)], _SETTINGS).findings[:1]
            hit = any(f.kind == "swap" and set(f.inputs) == {names[i], names[j]} for f in first)
            outcome.found[days, 0.0] = outcome.found.get((days, 0.0), 0) + hit


def check_outcome(kind: str, seed: int, *, loads: bool = False) -> SensorOutcome:
    """One machine's twelve days; `off`: a shop's day switched off for eight hours of the night and at the weekend.

    loads: whether the watch knows the speeds and the coolant, too
    """
    m = machine_days("day" if kind == "off" else kind, seed, 24 * DAYS, off=_is_off if kind == "off" else None)
    known = [*range(_SENSORS), *(range(_SENSORS + 1, len(m.names)) if loads else ())]  # the one between is a length
    names, x, outcome = tuple(m.names[i] for i in known), m.inputs[:, known], SensorOutcome()
    asyncio.run(_watch(names, x, outcome))
    if kind != "off":
        _detect(names, x, seed, outcome)
    return outcome


def _is_off(k: int) -> bool:
    """Whether each grid step k since Monday, 6 h, is at night, on Saturday or on Sunday."""
    return k % _DAY >= 16 * 12 or k // _DAY % 7 >= 5


def rows() -> list[BenchRow]:
    """False alarms, detection after a given number of days of learning, and the pairs that look alike."""
    jobs = [(kind, seed) for kind in ("day", "axes", "off") for seed in SEEDS]
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        every = list(pool.map(check_outcome, *zip(*jobs, strict=True)))
    outcomes, off = every[: 2 * len(SEEDS)], every[2 * len(SEEDS) :]
    table = []
    for text, some in (("", outcomes), (", switched off at night and, as not learnt, at the weekend", off)):
        told = [text for o in some for text in o.told]
        years = sum(o.watched_days for o in some) / 365.25
        table.append(BenchRow(f"false alarms in {years:.2f} machine-years{text}", f"{len(told)}", "; ".join(told)))
    for days in _LEARNT:
        shares = {
            size: sum(o.found[days, size] for o in outcomes) / (DRAWS * len(outcomes)) for size in (0.0, *_OFFSETS_K)
        }
        smallest = np.percentile([v for o in outcomes for v in o.smallest[days]], [10, 50, 90])
        offsets = ", ".join(f"{size:g} K {shares[size]:.0%}" for size in _OFFSETS_K)
        table.append(
            BenchRow(
                f"found and named after {days} {'day' if days == 1 else 'days'} of learning",
                f"exchanges {shares[0.0]:.0%}; offsets of {offsets}",
                f"claims to see {smallest[0]:.1f}, {smallest[1]:.1f}, {smallest[2]:.1f} K (10, 50, 90 % of inputs)",
            )
        )
    windows = sum(o.windows for o in outcomes)
    pairs = [pair for o in outcomes for pair in o.alike]
    often = sorted(((pairs.count(pair) / windows, pair) for pair in set(pairs)), reverse=True)[:6]
    text = "; ".join(f"{a}, {b} {share:.0%}" for share, (a, b) in often)
    table.append(BenchRow("pairs that a window of 8 h most often cannot tell apart", text, "after 8 days of learning"))
    return table
