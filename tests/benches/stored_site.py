"""Gateways of a site without a network: their databases, asked as over the network, payload for payload."""

from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from pyarrow import dataset

from drivers.base import Quality
from gateway.listeners.collect.collector import Collector, SiteKept
from gateway.model.events import DecisionMade, EventReported, FrameMade, MeasurementEnded, ReadingsTaken, ReasonsGiven
from gateway.model.probing import Outcome
from gateway.model.sample import Sample
from gateway.service.stored_answers import rows_of
from gateway.storage.store import Store
from gateway.telemetry.answers import StoredRows
from gateway.telemetry.codec import decode_answer, encode
from gateway.telemetry.stored_queries import StoredRequest
from talc.frame import Event, EventKind, Frame, Measurement, Why
from tests.benches import telemetry_examples as example
from tests.benches.stepped_clock import EPOCH, SteppedClock
from tests.benches.waits import turns

STEP_S = 300
FIRST_K = int(EPOCH.timestamp()) // STEP_S
FOUND = datetime(2026, 3, 3, 7, tzinfo=UTC)
"""When the collector asks."""


class StoredSite:
    """Implements what a collector asks."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.away: set[str] = set()
        self.asked: list[str] = []

    def path(self, machine: str) -> Path:
        return self.folder / f"{machine}.sqlite"

    def running(self) -> list[str]:
        return sorted(path.stem for path in self.folder.glob("*.sqlite") if path.stem not in self.away)

    def ask(self, machine: str, after: Mapping[str, tuple[str, int] | None], limit: int) -> StoredRows:
        self.asked.append(machine)
        return decode_answer(StoredRows, encode(rows_of(self.path(machine))(StoredRequest(after, limit))))


def step(store: Store, n: int) -> None:
    """The n-th step of a machine: two channels at its begin, a frame and a decision, each tenth a measurement, an
    event and the learner's reasons."""
    at = EPOCH + timedelta(seconds=STEP_S * n)
    store.record(
        ReadingsTaken([Sample(c, n + 0.5, "degC", Quality.GOOD, at, 0.0, sequence=n + 1) for c in ("bed", "column")])
    )
    k = FIRST_K + n
    store.record(FrameMade(Frame(k, np.array([20.5 + n, np.nan]), np.array([True, False]))))
    store.record(DecisionMade(replace(example.DECISION, k=k)))
    if n % 10 == 0:
        measured = Measurement(np.full(9, float(n)), np.full(9, 0.5))
        outcome = Outcome(n, Why.INTERVAL, at, at, np.zeros((6, 3)), (0.0, 0.0, 0.0), measured, 0.4)
        store.record(MeasurementEnded(outcome))
        store.record(EventReported(Event(EventKind.PROBLEM, f"number {n}"), k))
        store.record(ReasonsGiven(replace(example.REASONS, k=k)))


def write(site: StoredSite, machine: str, steps: range, boot: str = "boot-1") -> None:
    """Let one boot of a machine store these steps."""
    with Store(site.path(machine), boot, SteppedClock()) as store:
        for n in steps:
            step(store, n)


def collector(site: StoredSite, kept: SiteKept, limit: int = 100) -> Collector:
    """A collector that asks every 30 s, for at most this many rows."""
    return Collector(site, kept, every_s=30.0, limit=limit, utc=lambda: FOUND)


def catch_up(collecting: Collector, now_s: float = 0.0) -> int:
    """Take turns until nothing more is due; returns how many."""
    return next(number for number in turns(1000) if collecting.turn(now_s) > now_s)


def rows(folder: Path, table: str, machine: str = "mill") -> list[dict[str, Any]]:
    """In the order in which they were kept."""
    place = folder / table / f"machine={machine}"
    files = sorted(place.rglob("*.parquet"))
    return [row for file in files for row in dataset.dataset(file).to_table().to_pylist()]


def kept(folder: Path, machine: str = "mill") -> dict[str, list[Any]]:
    """What distinguishes the rows of each table."""
    return {
        "readings": [(r["channel"], r["sequence"], r["value"]) for r in rows(folder, "readings", machine)],
        "steps": [r["k"] - FIRST_K for r in rows(folder, "steps", machine)],
        "measurements": [r["number"] for r in rows(folder, "measurements", machine)],
        "events": [r["text"] for r in rows(folder, "events", machine)],
        "reasons": [r["k"] - FIRST_K for r in rows(folder, "reasons", machine)],
    }


def expected(steps: range) -> dict[str, list[Any]]:
    tens = [n for n in steps if n % 10 == 0]
    return {
        "readings": [(c, n + 1, n + 0.5) for n in steps for c in ("bed", "column")],
        "steps": list(steps),
        "measurements": tens,
        "events": [f"number {n}" for n in tens],
        "reasons": tens,
    }
