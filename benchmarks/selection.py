"""Whole selections of nine models, compared with a textbook implementation of the same swarm; and a replay."""

import time
from functools import partial

import numpy as np
from scipy.signal import lfilter

from benchmarks.admm import admm
from benchmarks.data import machine_days
from benchmarks.rows import BenchRow, median_s
from studies import Days
from talc.control import Controller
from talc.frame import Frame, Measurement, TrainingJob, Why
from talc.models import ModelSet
from talc.papers.arx import Regression
from talc.papers.criteria import adapted_bic
from talc.papers.pso import select_by_swarm
from talc.papers.training import train
from talc.papers.window import Structure, Window
from talc.settings import TalcSettings, TrainingSettings

TRIALS = 12
"""Number of candidates of the textbook implementation that are timed."""
PLACED = 240
"""Number of our candidates: enough that the swarm's one-off preparation does not count."""


def _job(m: Days, settings: TrainingSettings) -> TrainingJob:
    valid = np.ones(m.inputs.shape, dtype=np.bool_)
    return TrainingJob(0, Why.CALIBRATION, m.names, m.inputs, valid, m.measured, settings)


def _textbook_candidate(regression: Regression, draw: np.random.Generator, loop: bool) -> float:
    """One random candidate as the papers' code has it: ADMM on its own Gram, then the free run in a loop or by
    lfilter. Drawn as a swarm places its first particles."""
    w = regression.window
    n_inputs = w.u.shape[1]
    na, orders = int(draw.integers(0, 6)), tuple(int(draw.integers(0, 6)) for _ in range(n_inputs))
    structure = Structure(na, tuple(range(n_inputs)), orders)
    x = regression.columns(structure)
    q = np.linalg.qr(x[:, : 1 + na])[0]
    lagged = x[:, 1 + na :]
    left, target = lagged - q @ (q.T @ lagged), regression.y - q @ (q.T @ regression.y)
    gram, moment = left.T @ left + 1e-5 * len(target) * np.eye(left.shape[1]), left.T @ target
    sizes = [nb + 1 for nb in orders]
    starts = np.concatenate([[0], np.cumsum(sizes)[:-1]])
    top = (2.0 * np.sqrt(np.add.reduceat(moment**2, starts) / sizes)).max()
    penalty = float(top * np.exp(draw.uniform(np.log(1e-4), 0.0)))
    theta = admm(gram, moment, float(target @ target), sizes, penalty, limit=20_000)[0]
    phi = np.linalg.lstsq(x[:, : 1 + na], regression.y - lagged @ theta, rcond=None)[0]
    drive = phi[0] + lagged @ theta
    if loop:
        run: list[float] = []
        for k in range(len(drive)):
            run.append(float(drive[k]) + sum(float(phi[i]) * run[k - i] for i in range(1, na + 1) if k >= i))
        residual = regression.y - np.array(run)
    else:
        residual = regression.y - lfilter([1.0], [1.0, *-phi[1:]], drive)
    return adapted_bic(residual * w.y_std, na + sum(orders), n_inputs, 5.0, 0.75)


def _replayed(m: Days, models: ModelSet) -> float:
    """Seconds for all rows through a controller that has its models."""
    controller = Controller(m.names, TalcSettings(method="models"))
    valid = np.ones(len(m.names), dtype=np.bool_)
    start = time.perf_counter()
    for k in range(len(m.inputs)):
        measured = Measurement(m.measured[k], m.sigma) if k < 288 or k % 24 == 0 else None
        if controller.step(Frame(k, m.inputs[k], valid, measured)).training is not None and k < 400:
            controller.adopt(models)
    return time.perf_counter() - start


def rows() -> list[BenchRow]:
    """Selections, the swarm's ratio to the textbook, and the replay."""
    day, weeks = machine_days("day", 3, 24), machine_days("axes", 3, 340)
    search, swarm = TrainingSettings(), TrainingSettings(selector="pso", max_na=5, max_nb=5)
    short = median_s(partial(train, _job(day, search)), 5)
    long = median_s(partial(train, _job(weeks, search)), 3)
    pso = median_s(partial(train, _job(day, swarm)), 3)
    u = day.inputs[:, day.inputs.std(axis=0) > 1e-6]
    y = (day.measured[:, 1] - day.measured[:, 1].mean()) / day.measured[:, 1].std()
    scaled = (u - u.mean(axis=0)) / u.std(axis=0)
    regression = Regression(Window(scaled, y, y, float(day.measured[:, 1].std())), 5, 5)
    # A swarm converges to candidates that are cheaper than random ones; compare only like with like.
    ours = median_s(partial(select_by_swarm, regression, seed=0, swarm=PLACED, iterations=0), 3) / PLACED
    textbook = {}
    for loop in (True, False):
        draw = np.random.default_rng(0)
        start = time.perf_counter()
        for _ in range(TRIALS):
            _textbook_candidate(regression, draw, loop)
        textbook[loop] = (time.perf_counter() - start) / TRIALS
    replayed = sorted(_replayed(weeks, train(_job(day, search))) for _ in range(3))[1]
    return [
        BenchRow("`search`, nine errors, 24 h", f"{short:.2f} s"),
        BenchRow("`search`, nine errors, 340 h", f"{long:.2f} s"),
        BenchRow("`pso` 40 × 60, nine errors, 24 h", f"{pso:.2f} s"),
        BenchRow(
            "a random candidate of such a swarm by ADMM and a Python loop",
            f"{textbook[True] / ours:.0f} × ours",
            f"{textbook[True] * 1e3:.0f} ms, mean of {TRIALS}; ours {ours * 1e3:.2f} ms",
        ),
        BenchRow(
            "the same by ADMM and lfilter", f"{textbook[False] / ours:.0f} × ours", f"{textbook[False] * 1e3:.0f} ms"
        ),
        BenchRow("replay of 340 h without training", f"{replayed:.2f} s"),
    ]
