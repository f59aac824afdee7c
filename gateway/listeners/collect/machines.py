"""The machines of a collected site, with all that each of them learnt from: its latest settings, and every frame."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow import parquet
from pydantic import TypeAdapter

from drivers.error_words import in_words
from gateway.listeners.collect.folder import CollectError
from gateway.listeners.collect.progress import TablePlace, load_progress
from gateway.storage import columns
from talc.frame import FloatArray, Frame, Measurement
from talc.names import THERMAL_ERRORS
from talc.settings import TalcSettings

RUN_FIELDS = ("kind", "step_s", "inputs", "talc", "epoch", "row")
_TIME_OFF_US = 1000
"""Largest difference between the time of a step and the time of its grid index: both are rounded."""
_STEPS: columns.CellKinds = columns.steps(())
_ERRORS = [name for name in _STEPS if name.startswith(tuple(f"measured_{error}" for error in THERMAL_ERRORS))]
_SIGMA = [name for name in _STEPS if name.startswith(tuple(f"measured_sigma_{error}" for error in THERMAL_ERRORS))]


@dataclass(frozen=True, slots=True)
class CollectedMachine:
    """One machine of a site."""

    name: str
    kind: str | None
    inputs: tuple[str, ...]
    """Inputs of its latest run; `step_s` and `talc` likewise."""
    step_s: float
    talc: TalcSettings
    """Without the prior that it began with."""
    days: Callable[[Sequence[str]], Iterator[pa.Table]]
    """Some columns of its steps, a day at a time; of the steps of one time, the one that was collected first is first.
    Raises CollectError for what cannot be read."""

    def frames(self) -> Iterator[Frame]:
        """The frames of every step, oldest first, with the inputs of the latest run. Raises CollectError for what
        cannot be read."""
        for table in self.days(self._columns):
            yield from self._frames(table)

    @property
    def _columns(self) -> list[str]:
        return ["k", "time", "pause_unknown", *_ERRORS, *_SIGMA, *(f"input_{name}" for name in self.inputs)]

    def _frames(self, table: pa.Table) -> Iterator[Frame]:
        """The frames of a day. A grid of another step has other indices for the same times, and those are left out."""
        k, time_us = table["k"].to_numpy(), table["time"].cast(pa.int64()).to_numpy()
        own = np.abs(k * (self.step_s * 1e6) - time_us) <= _TIME_OFF_US
        _, first = np.unique(k[own], return_index=True)
        rows = np.flatnonzero(own)[first]
        inputs = _numbers(table, [f"input_{name}" for name in self.inputs])[rows]
        errors, sigma = _numbers(table, _ERRORS)[rows], _numbers(table, _SIGMA)[rows]
        unknown = _numbers(table, ["pause_unknown"])[rows, 0] > 0.0
        for i, index in enumerate(k[rows].tolist()):
            measured = np.isfinite(errors[i]).any() or np.isfinite(sigma[i]).any()
            measurement = Measurement(errors[i], sigma[i]) if measured else None
            yield Frame(index, inputs[i], np.isfinite(inputs[i]), measurement, bool(unknown[i]))


def machines_in(site: Path) -> list[CollectedMachine]:
    """Every machine of a folder of `talc-gateway collect`, also while a collector writes to it.

    Raises CollectError if it is no such folder, or if a file in it is damaged.
    """
    found = [_machine(site, folder) for folder in sorted((site / "runs").glob("machine=*"))]
    if not found:
        raise CollectError(f"{site}: contains no run of any machine; give a folder of `talc-gateway collect`")
    return found


def _machine(site: Path, runs: Path) -> CollectedMachine:
    name = runs.name.removeprefix("machine=")
    try:
        places = load_progress(site / "progress" / f"{name}.json").places
        parts = runs.glob("day=*/part-*.parquet")
        rows = list(chain.from_iterable(_read(part, RUN_FIELDS).to_pylist() for part in parts))
        return machine_of(name, rows, places.get("runs", ()), partial(_days, site / "steps" / f"machine={name}"))
    except ValueError as error:
        raise CollectError(f"{runs}: its latest run cannot be read: {error}; collect this machine again") from error


def machine_of(
    name: str,
    runs: Sequence[Mapping[str, Any]],
    places: Sequence[TablePlace],
    days: Callable[[Sequence[str]], Iterator[pa.Table]],
) -> CollectedMachine:
    """A machine by its latest run.

    runs: rows of the table `runs` with RUN_FIELDS
    places: how far that table is collected, the latest epoch last

    Raises ValueError if there is no run, or if this program cannot read it.
    """
    latest = [max((r for r in runs if r["epoch"] == epoch), key=_row, default=None) for epoch, _ in places]
    run = next((r for r in reversed(latest) if r is not None), None)
    if run is None:
        raise ValueError("there is none")
    try:
        talc = TypeAdapter(TalcSettings).validate_python({**json.loads(run["talc"]), "prior": None})
        inputs = tuple(map(str, json.loads(run["inputs"])))
        return CollectedMachine(name, run["kind"], inputs, float(run["step_s"]), talc, days)
    except TypeError as error:
        raise ValueError(str(error)) from error


def _days(steps: Path, names: Sequence[str]) -> Iterator[pa.Table]:
    for day in sorted(steps.glob("day=*")):
        yield pa.concat_tables([_read(part, names) for part in sorted(day.glob("part-*.parquet"))])


def _row(run: Mapping[str, Any]) -> int:
    return int(run["row"])


def _read(part: Path, names: Sequence[str]) -> pa.Table:
    """These columns of a file; those that it does not have are empty."""
    try:
        with parquet.ParquetFile(part) as file:
            there = [name for name in names if name in file.schema_arrow.names]
            table = file.read(columns=there)
    except (OSError, pa.ArrowException) as error:
        raise CollectError(f"{part}: cannot be read: {in_words(error)}") from error
    for name in names:
        if name not in there:
            table = table.append_column(name, pa.nulls(table.num_rows, pa.float64()))
    return table.select(list(names))


def _numbers(table: pa.Table, names: Sequence[str]) -> FloatArray:
    """(rows, columns), NaN for nothing."""
    found = np.full((table.num_rows, len(names)), np.nan)
    for column, name in enumerate(names):
        found[:, column] = table[name].cast(pa.float64()).to_numpy()
    return found
