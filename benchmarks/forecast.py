"""The learner's forecasts on the simulated machines, against the truth when their time has come.

A day measured hourly, then each 2 h. In each hour of the last three days it computes how far off each of these is at
each later time: the error as it is estimated now; the learner if the inputs stay as they are; the learner if
temperatures go on as they change now, and this change fades. It also counts how often the truth lies within the
interval that the page states.
"""

import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np

from benchmarks.data import machine_days
from benchmarks.learner import MACHINES, day_then_every
from benchmarks.rows import BenchRow
from talc.control import Controller
from talc.forecast import ForecastRecord
from talc.frame import FloatArray, Frame, Measurement
from talc.indicators import TWO_SIDED_95
from talc.settings import TalcSettings

_SETTINGS = TalcSettings(method="learner")
HOURS, _DAY, _EVERY, _POSITIONS = 96, 288, 12, 6
AHEAD = (6, 12, 24, 48, 96)
"""Steps of 5 min."""
_FADING = 12.0
"""Steps; a shorter one loses less, a longer one more."""
_LATELY = 6
"""Steps over which the present change of a temperature is taken."""
_TEMPERATURES = 30


@dataclass(frozen=True, slots=True)
class ForecastOutcome:
    """One machine's four days, each (S, 9)."""

    held: FloatArray
    """E_RMS of the error as it is now; likewise of the others."""
    stays: FloatArray
    continued: FloatArray
    inside: FloatArray
    """Share of the truth within 1.96 of the root of sigma² + miss²."""


def _continued(controller: Controller, inputs: FloatArray) -> FloatArray:
    """(S, 9) estimates of a copy whose inputs go on; inputs: (_LATELY + 1, n) the latest."""
    copy = Controller.restore(controller.state(), _SETTINGS)
    rate = (inputs[-1] - inputs[0]) / _LATELY
    rate[_TEMPERATURES:] = 0.0
    k, valid, found = copy.state().last_k or 0, np.ones(inputs.shape[1], dtype=np.bool_), []
    for ahead in range(1, AHEAD[-1] + 1):
        row = inputs[-1] + rate * _FADING * (1.0 - np.exp(-ahead / _FADING))
        decision = copy.step(Frame(k + ahead, row, valid, None))
        if ahead in AHEAD:
            found.append(decision.corrected)
    return np.stack(found)


def _run(kind: str, seed: int) -> ForecastOutcome:
    m = machine_days(kind, seed, HOURS)
    rows = len(m.inputs)
    used, valid = day_then_every(12, 24, rows), np.ones(len(m.names), dtype=np.bool_)
    controller, record = Controller(m.names, _SETTINGS), ForecastRecord(AHEAD, 300.0)
    off = np.full((3, rows, len(AHEAD), 9), np.nan)
    inside = np.full((rows, len(AHEAD), 9), np.nan)
    for k, row in enumerate(m.inputs):
        decision = controller.step(Frame(k, row, valid, Measurement(m.measured[k], m.sigma) if used[k] else None))
        forecast = controller.forecast(AHEAD)
        if forecast is None:
            raise RuntimeError("the learner makes no forecast")
        misses = record.take(forecast, decision.corrected, decision.sigma, measured=bool(used[k]))
        if k < _DAY or k % _EVERY:
            continue
        others = _continued(controller, m.inputs[k - _LATELY : k + 1])
        for i, ahead in enumerate(AHEAD):
            if k + ahead < rows:
                truth = m.truth[k + ahead]
                off[:, k, i] = truth - decision.corrected, truth - forecast.value[i], truth - others[i]
                half = TWO_SIDED_95 * np.sqrt(forecast.sigma[i] ** 2 + misses.value[i] ** 2)
                inside[k, i] = np.where(np.isfinite(half), np.abs(off[1, k, i]) <= half, np.nan)
    held, stays, continued = np.sqrt(np.nanmean(off**2, axis=1))
    return ForecastOutcome(held, stays, continued, np.nanmean(inside, axis=0))


def rows() -> list[BenchRow]:
    """All rows of the table; takes a few minutes."""
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        found = list(pool.map(_run, *zip(*MACHINES, strict=True)))

    def mean(values: list[FloatArray]) -> str:
        return ", ".join(f"{v:.2f}" for v in np.exp(np.log(np.array(values)[..., :_POSITIONS]).mean(axis=(0, 2))))

    table = []
    for kind, name in (("day", "a shop's days"), ("axes", "random loads")):
        own = [f for (k, _), f in zip(MACHINES, found, strict=True) if k == kind]
        table += [
            BenchRow(
                f"E_RMS in µm after 0.5, 1, 2, 4, 8 h, {name}: the error stays as it is", mean([f.held for f in own])
            ),
            BenchRow(
                "the same over it: the inputs stay (beside: they go on and fade)",
                mean([f.stays / f.held for f in own]),
                mean([f.continued / f.held for f in own]),
            ),
            BenchRow(
                "truth within the stated interval of the forecast",
                ", ".join(f"{v:.0%}" for v in np.nanmean([f.inside for f in own], axis=(0, 2))),
            ),
        ]
    return table
