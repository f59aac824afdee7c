"""The subject `recordings` of `make bench`: all recordings of a folder, all methods, then the pages and the table."""

import os
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from pathlib import Path

import numpy as np

from benchmarks.recordings.chosen import methods
from benchmarks.recordings.description import Description, recordings_in
from benchmarks.recordings.judge import apply_method, judge_course, rows_to_measure
from benchmarks.recordings.methods import Method
from benchmarks.recordings.policy import FIXED_MIN, LIMITS_UM, Deciding, Saving, Sweep, savings
from benchmarks.recordings.result import JUDGED_UNITS, Cell, Result, policy_rows, table_rows, write_result
from benchmarks.recordings.series import Series, read_series
from benchmarks.rows import BenchRow
from gateway.config.problems import ConfigError
from gateway.reporting.recordings.problems import RecordingError

SHIPPED = Path(__file__).with_name("fl_thermal")
OUT = Path("out/recordings")
_LONG_H = 100.0
"""Limits of longer recordings are swept after the second beginning only, so that a run ends within minutes."""
_DEFAULT = "learner"
"""The method that the table is about."""


def folder() -> Path:
    """RECORDINGS of the environment; by default the recording that the project ships."""
    return Path(os.environ.get("RECORDINGS") or SHIPPED)


def is_shipped() -> bool:
    """Whether the figures belong in docs/figures.md."""
    return folder().resolve() == SHIPPED.resolve() and not os.environ.get("METHODS")


def rows() -> list[BenchRow]:
    """Every recording; one that cannot be used is reported and skipped. SystemExit: none could be used."""
    found, wrong = [], []
    try:
        descriptions = recordings_in(folder())
    except ConfigError as error:
        raise SystemExit(str(error)) from None
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        for path in descriptions:
            begin = time.perf_counter()
            try:
                said, series = read_series(path)
            except (ConfigError, RecordingError) as error:
                wrong.append(str(error))
                print(error, file=sys.stderr, flush=True)
                continue
            chosen = methods(series, os.environ.get("METHODS", ""))
            result = carry_out_all(said, series, chosen, pool)
            write_result(result, OUT)
            print(f"{series.name}: {time.perf_counter() - begin:.0f} s; {OUT}/", file=sys.stderr, flush=True)
            ours = _DEFAULT if _DEFAULT in result.methods else chosen[-1].name
            found += table_rows(result, ours)
            found += policy_rows(result, ours)
    if wrong and not found:
        raise SystemExit("no recording could be used")
    return found


def carry_out_all(said: Description, series: Series, chosen: Sequence[Method], pool: ProcessPoolExecutor) -> Result:
    """Every method after every beginning at every interval, with measurements at the same times."""
    hours = [h for h in said.beginnings_h if h < series.on_h[-1]]
    ways = list(product(hours, said.intervals_min))
    jobs = [(said, series, method, h, minutes) for h, minutes in ways for method in chosen]
    cells = list(pool.map(cell, *zip(*jobs, strict=True)))
    deciding = sorted((m for m in chosen if isinstance(m, Deciding)), key=lambda m: m.name != _DEFAULT)
    swept = hours[1:2] if series.on_h[-1] > _LONG_H else hours[:2]
    return Result(series, cells, _savings(said, series, deciding, swept, pool) if deciding else {})


def _savings(
    said: Description, series: Series, deciding: Sequence[Deciding], hours: Sequence[float], pool: ProcessPoolExecutor
) -> dict[tuple[str, str, float], Sequence[Saving]]:
    """Limits of each method against fixed intervals of the first one, by method, unit and beginning."""
    found: dict[tuple[str, str, float], Sequence[Saving]] = {}
    units = [unit for unit, there in zip(JUDGED_UNITS, (~series.angle, series.angle), strict=True) if there.any()]
    for dense_h in hours:
        sweeps = [(method, Sweep(dense_h, limit=limit)) for method in deciding for limit in LIMITS_UM]
        sweeps += [(deciding[0], Sweep(dense_h, interval_min=interval)) for interval in FIXED_MIN]
        jobs = [(sweep, method, series, said.seed, said.runs.measure_first) for method, sweep in sweeps]
        points = list(pool.map(Sweep.points, *zip(*jobs, strict=True)))
        for u, unit in enumerate(units):
            of = [point[u] for point in points]
            for n, method in enumerate(deciding):
                ours = of[n * len(LIMITS_UM) : (n + 1) * len(LIMITS_UM)]
                found[method.name, unit, dense_h] = savings(ours, of[len(deciding) * len(LIMITS_UM) :])
    return found


def cell(said: Description, series: Series, method: Method, dense_h: float, interval_min: float) -> Cell:
    """One method after one beginning at one interval."""
    begin = time.perf_counter()
    used = rows_to_measure(series, dense_h, interval_min, said.runs.measure_first)
    course = apply_method(method, series, used, said.seed, dense_h, interval_min)
    figures = {}
    if course is not None:
        for unit, there in zip(JUDGED_UNITS, (~series.angle, series.angle), strict=True):
            if there.any():
                figures[unit] = judge_course(series, course, dense_h, np.flatnonzero(there).tolist())
    return Cell(method.name, dense_h, interval_min, int(used.sum()), time.perf_counter() - begin, figures)
