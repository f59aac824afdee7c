"""The result for one recording: as JSON, as Markdown, and as rows of the table in docs/figures.md."""

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.recordings.judge import FIRST_HOURS, Figures
from benchmarks.recordings.policy import Point, Saving
from benchmarks.recordings.series import Series
from benchmarks.rows import BenchRow
from talc.indicators import Spread

JUDGED_UNITS = ("µm", "µm/m")


@dataclass(frozen=True, slots=True)
class Cell:
    """One method after one beginning at one interval."""

    method: str
    dense_h: float
    interval_min: float
    measurements: int
    """All, the beginning's included."""
    seconds: float
    figures: dict[str, Figures]
    """By unit; empty: the method cannot start from this beginning."""


@dataclass(frozen=True, slots=True)
class Result:
    """One recording."""

    series: Series
    cells: Sequence[Cell]
    savings: dict[tuple[str, str, float], Sequence[Saving]]
    """Savings of policies, by method, unit and hours of dense beginning."""

    @property
    def units(self) -> list[str]:
        return [
            unit
            for unit, there in zip(JUDGED_UNITS, (~self.series.angle, self.series.angle), strict=True)
            if there.any()
        ]

    def cell(self, method: str, dense_h: float, interval_min: float) -> Cell | None:
        return next(
            (c for c in self.cells if (c.method, c.dense_h, c.interval_min) == (method, dense_h, interval_min)), None
        )

    @property
    def methods(self) -> list[str]:
        return list(dict.fromkeys(c.method for c in self.cells))

    @property
    def ways(self) -> list[tuple[float, float]]:
        """Beginnings and intervals."""
        return list(dict.fromkeys((c.dense_h, c.interval_min) for c in self.cells))


def table_rows(result: Result, method: str) -> list[BenchRow]:
    """A row for each beginning and interval: the method, and all others beside it."""
    found = []
    for unit in result.units:
        for dense_h, interval_min in result.ways:
            ours = result.cell(method, dense_h, interval_min)
            if ours is None or unit not in ours.figures:
                continue
            f = ours.figures[unit]
            hold = _figures(result, "hold", dense_h, interval_min, unit)
            over = f"{f.rms / hold.rms:.2f} of hold, " if hold is not None and hold.rms > 0 else ""
            others = [
                f"{name} {there.rms:.2f}"
                for name in result.methods
                if name != method and (there := _figures(result, name, dense_h, interval_min, unit)) is not None
            ]
            found.append(
                BenchRow(
                    f"{result.series.name}, {result.series.units_read}, {_beginning(dense_h)}, then each "
                    f"{interval_min:g} min ({ours.measurements} measurements): RMSE {unit} of {method}",
                    f"{f.rms:.2f}: {over}P99 {f.p99:.1f}, largest {f.largest:.1f}; "
                    f"first hour {_written(f.first_hour)}, after it {_written(f.later)}; "
                    f"95 % intervals hold {_share(f.inside)}",
                    ", ".join(others),
                )
            )
    return found


def policy_rows(result: Result, method: str) -> list[BenchRow]:
    """A row for each beginning and limit: the method that decides when to measure, and the others that do."""
    found = []
    for (name, unit, dense_h), savings in result.savings.items():
        if name != method:
            continue
        others = {n: s for (n, u, h), s in result.savings.items() if n != method and (u, h) == (unit, dense_h)}
        found += [
            BenchRow(
                f"{result.series.name}, {result.series.units_read}, {_beginning(dense_h)}, then measured by {method} "
                f"within {saving.point.what}",
                f"{_told(saving.point, unit)}; {_plain(saving.at_equal_p99)} of a fixed interval's at equal P99",
                "; ".join(f"{other} {_told(same[i].point, unit)}" for other, same in others.items()),
            )
            for i, saving in enumerate(savings)
        ]
    return found


def _told(point: Point, unit: str) -> str:
    return f"{point.measurements} measurements after it, RMSE {point.rms:.2f} {unit}, P99 {point.p99:.1f}"


def markdown(result: Result) -> str:
    """The recording's page."""
    s = result.series
    off_h = (s.k[-1] - s.k[0]) * s.step_s / 3600.0 - s.on_h[-1]
    lines = [
        f"# {s.name}",
        "",
        f"{len(s.k)} steps of {s.step_s:g} s, {s.on_h[-1]:.1f} h in {int(s.run[-1]) + 1} runs, {off_h:.1f} h off "
        f"between them; {len(s.input_names)} inputs, {np.isnan(s.inputs).mean():.1%} of their values missing; "
        f"errors {', '.join(s.error_names)}, {s.units_read}.",
        "",
        *(f"- {note}" for note in s.notes),
        "",
    ]
    for unit in result.units:
        lines += _main_table(result, unit)
        lines += _curve_table(result, unit)
        lines += _policy_table(result, unit)
        lines += _error_table(result, unit)
    return "\n".join(lines) + "\n"


def _main_table(result: Result, unit: str) -> list[str]:
    lines = [
        f"## Left of the errors in {unit}, all rows after the beginning, judged before each measurement",
        "",
        "| beginning | then each | measurements | method | RMSE | P99 | largest | first hour: RMSE | E_PV | "
        "after it: RMSE | E_PV | over none | over hold | 95 % hold | seconds |",
        f"|---|---|---:|---|{'---:|' * 11}",
    ]
    for dense_h, interval_min in result.ways:
        none, hold = (_figures(result, name, dense_h, interval_min, unit) for name in ("none", "hold"))
        for name in result.methods:
            cell = result.cell(name, dense_h, interval_min)
            where = f"| {_beginning(dense_h)} | {interval_min:g} min |"
            if cell is None:
                continue
            if unit not in cell.figures:
                lines.append(f"{where} {cell.measurements} | {name} | {'– | ' * 10}{cell.seconds:.1f} |")
                continue
            f = cell.figures[unit]
            lines.append(
                f"{where} {cell.measurements} | {name} | {f.rms:.2f} | {f.p99:.2f} | {f.largest:.2f} | "
                f"{_cells(f.first_hour)} | {_cells(f.later)} | "
                f"{_ratio(f, none)} | {_ratio(f, hold)} | {_share(f.inside)} | {cell.seconds:.1f} |"
            )
    return [*lines, ""]


def _curve_table(result: Result, unit: str) -> list[str]:
    """The first hours, without any dense beginning."""
    windows = [f"{a:g}–{b:g} h" if math.isfinite(b) else "later" for a, b in pairwise(FIRST_HOURS)]
    lines = [
        f"## From the first hour: RMSE over that of no compensation, {unit}",
        "",
        f"| each | method | {' | '.join(windows)} |",
        f"|---|---|{'---:|' * len(windows)}",
    ]
    for dense_h, interval_min in result.ways:
        if dense_h > 0:
            continue
        for name in result.methods:
            found = _figures(result, name, dense_h, interval_min, unit)
            if found is not None and name != "none":
                cells = " | ".join("–" if math.isnan(v) else f"{v:.2f}" for v in found.curve)
                lines.append(f"| {interval_min:g} min | {name} | {cells} |")
    return [*lines, ""]


def _policy_table(result: Result, unit: str) -> list[str]:
    if not any(u == unit for _, u, _ in result.savings):
        return []
    lines = [
        f"## Measuring when it is needed, {unit}",
        "",
        "| beginning | method | limit | measurements after it | RMSE | P99 | 95 % hold | "
        "of a fixed interval's at equal RMSE | at equal P99 |",
        "|---|---|---|---:|---:|---:|---:|---:|---:|",
    ]
    for (method, u, dense_h), savings in result.savings.items():
        if u != unit:
            continue
        for s in savings:
            p = s.point
            lines.append(
                f"| {_beginning(dense_h)} | {method} | {p.what} | {p.measurements} | {p.rms:.2f} | {p.p99:.2f} | "
                f"{_share(p.inside)} | {_plain(s.at_equal_rms)} | {_plain(s.at_equal_p99)} |"
            )
    return [*lines, ""]


def _error_table(result: Result, unit: str) -> list[str]:
    here = [
        n for n, a in zip(result.series.error_names, result.series.angle, strict=True) if a == (unit == JUDGED_UNITS[1])
    ]
    lines = [
        f"## RMSE of each error, {unit}",
        "",
        f"| beginning | then each | method | {' | '.join(here)} |",
        f"|---|---|---|{'---:|' * len(here)}",
    ]
    for dense_h, interval_min in result.ways:
        for name in result.methods:
            found = _figures(result, name, dense_h, interval_min, unit)
            if found is not None:
                cells = " | ".join(f"{v:.2f}" for v in found.by_error)
                lines.append(f"| {_beginning(dense_h)} | {interval_min:g} min | {name} | {cells} |")
    return [*lines, ""]


def as_json(result: Result) -> str:
    """All figures; a missing figure is null."""
    content = {
        "recording": result.series.name,
        "step_s": result.series.step_s,
        "steps": len(result.series.k),
        "runs": int(result.series.run[-1]) + 1,
        "errors": list(result.series.error_names),
        "units": list(result.series.units),
        "inputs": list(result.series.input_names),
        "notes": list(result.series.notes),
        "first_hours": [a for a in FIRST_HOURS if math.isfinite(a)],
        "cells": [asdict(cell) for cell in result.cells],
        "policy": [
            {"method": method, "unit": unit, "dense_h": dense_h, **asdict(saving)}
            for (method, unit, dense_h), savings in result.savings.items()
            for saving in savings
        ],
    }
    return json.dumps(_finite(content), indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def write_result(result: Result, folder: Path) -> None:
    """Markdown and JSON, named after the recording."""
    folder.mkdir(parents=True, exist_ok=True)
    stem = "".join(c if c.isalnum() or c in "-_" else "_" for c in result.series.name)
    (folder / f"{stem}.md").write_text(markdown(result), encoding="utf-8")
    (folder / f"{stem}.json").write_text(as_json(result), encoding="utf-8")


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(v) for key, v in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _figures(result: Result, method: str, dense_h: float, interval_min: float, unit: str) -> Figures | None:
    cell = result.cell(method, dense_h, interval_min)
    return None if cell is None else cell.figures.get(unit)


def _beginning(dense_h: float) -> str:
    return f"{dense_h:g} h dense" if dense_h > 0 else "at once"


def _ratio(figures: Figures, beside: Figures | None) -> str:
    return _plain(figures.rms / beside.rms) if beside is not None and beside.rms > 0 else "–"


def _cells(spread: Spread) -> str:
    return f"{_plain(spread.rms)} | {_plain(spread.pv)}"


def _written(spread: Spread) -> str:
    return f"{_plain(spread.rms)} (E_PV {_plain(spread.pv)})"


def _plain(value: float) -> str:
    return f"{value:.2f}" if math.isfinite(value) else "–"


def _share(value: float) -> str:
    return f"{value:.0%}" if math.isfinite(value) else "–"
