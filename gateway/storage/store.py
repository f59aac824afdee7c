"""Everything that happened, in one SQLite file: bounded, safe against power cuts, exact enough to replay.

Arrays are stored as little-endian float64 blobs and models as JSON whose floats round-trip, so what is read is bit for
bit what was written. The journal is a write-ahead log, synchronised with the disk at every commit
(gateway.storage.schema says why). Decisions and models are committed at once, because a decision that was acted upon
must not be lost; readings are committed in groups, at the latest after `commit_s`.
"""

import json
import queue
import sqlite3
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Self

import numpy as np

from drivers.base import Clock, Reading
from gateway.nc.slew import Write
from gateway.probing.cycle import Outcome
from gateway.probing.schedule import Outlook
from gateway.storage.schema import SCHEMA_VERSION, FileLock, StoreError, connect, make_schema
from gateway.storage.stored import StoredCompensation, StoredMeasurement, StoredStep
from talc.frame import BoolArray, Decision, Event, EventKind, FloatArray, Frame, Measurement, Phase, Why
from talc.models import ModelSet
from talc.sensor_check import Judgement

__all__ = [
    "History",
    "Store",
    "StoreError",
    "StoredCompensation",
    "StoredMeasurement",
    "StoredStep",
    "boot_id",
    "utc_of",
]

_SECONDS_PER_DAY = 86400.0
_PRUNE_EVERY_S = 600.0
_DRAIN_S = 0.1
_QUEUE = 20_000
"""Statements that may wait for the disk; beyond, the oldest readings would have to go, so writing waits instead."""


def _blob(values: object) -> bytes:
    return np.ascontiguousarray(values, dtype="<f8").tobytes()


def _array(blob: bytes) -> FloatArray:
    return np.frombuffer(blob, dtype="<f8").astype(np.float64)


class Store:
    """Writes one gateway's database. An Outlet; a context manager. One gateway per database.

    Parameters
    ----------
    path: the file; it and its folder are made if missing
    boot: identifies this run of the process; with a reading's sequence number it tells duplicates
    clock: for the time of events
    commit_s: readings are committed at least so often, real seconds
    keep_samples_days: older readings and compensation steps are deleted

    Raises StoreError: not a database of ours, of a newer version, locked by another gateway, or not writable.
    """

    def __init__(
        self, path: Path, boot: str, clock: Clock, *, commit_s: float = 1.0, keep_samples_days: float = 7.0
    ) -> None:
        self._path, self._boot, self._clock = path, boot, clock
        self._commit_s, self._keep_s = commit_s, keep_samples_days * _SECONDS_PER_DAY
        self._queue: queue.Queue[tuple[str, Sequence[Sequence[object]], bool] | None] = queue.Queue(_QUEUE)
        self._failure: BaseException | None = None
        self._closing = False
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StoreError(f"{path}: cannot be written: {error.strerror}") from error
        self._lock = FileLock(path)
        try:
            make_schema(path)
            self._number = _next_boot(path)
        except BaseException:
            self._lock.release()
            raise
        self._thread = threading.Thread(target=self._write, name=f"store {path.name}", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._closing = True
        self._queue.put(None)
        self._thread.join()
        self._lock.release()
        if self._failure is not None:
            raise StoreError(f"{self._path}: {self._failure}") from self._failure

    def flush(self) -> None:
        """Return when everything handed in so far is committed."""
        self._put("", (), commit=True)
        self._queue.join()

    def begin(self, config: str, fingerprint: str, versions: str) -> None:
        """Note what runs: configuration text, its hash, and the versions of what matters."""
        self._put(
            "INSERT INTO boot VALUES (?, ?, ?, ?, ?, ?)",
            [(self._number, self._boot, self._clock.utc().isoformat(), config, fingerprint, versions)],
            commit=True,
        )

    def runs(self, config: str, fingerprint: str) -> None:
        """Note the configuration that runs from now on: at the start and after every reload that took effect."""
        self._put(
            "INSERT INTO running VALUES (NULL, ?, ?, ?, ?)",
            [(self._number, self._clock.utc().isoformat(), config, fingerprint)],
            commit=True,
        )

    # Outlet ----------------------------------------------------------------------------------------------------------

    def readings(self, readings: Sequence[Reading]) -> None:
        rows = [
            (self._number, r.sequence, r.channel, r.source_time.timestamp(), None if r.value != r.value else r.value,
             r.unit, r.quality.value, r.detail)
            for r in readings
        ]  # fmt: skip
        self._put("INSERT OR IGNORE INTO sample VALUES (?, ?, ?, ?, ?, ?, ?, ?)", rows)

    def frame(self, frame: Frame) -> None:
        m = frame.measurement
        row = (
            frame.k, self._boot, _blob(frame.inputs), np.packbits(frame.valid).tobytes(),
            None if m is None else _blob(m.errors), None if m is None else _blob(m.sigma),
        )  # fmt: skip
        self._put("INSERT INTO frame VALUES (?, ?, ?, ?, ?, ?)", [row])

    def decision(self, decision: Decision) -> None:
        events = [[e.kind.value, e.text, e.error, e.value, e.limit] for e in decision.events]
        row = (
            decision.k, decision.phase.value, _blob(decision.predicted), _blob(decision.corrected),
            _blob(decision.sigma), _blob(decision.limits), decision.measure and decision.measure.value,
            decision.training and decision.training.why.value, json.dumps(events),
        )  # fmt: skip
        self._put("INSERT INTO decision VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)", [row], commit=True)

    def requested(self, number: int) -> None:
        self._put("DELETE FROM request", [()])  # the last one is all that matters
        self._put("INSERT INTO request VALUES (?, ?)", [(number, self._clock.utc().isoformat())])
        self.flush()

    def measurement(self, outcome: Outcome) -> None:
        m = outcome.measurement
        row = (
            outcome.number, outcome.why.value, outcome.asked.isoformat(), outcome.ended.isoformat(),
            None if outcome.centres_mm is None else _blob(outcome.centres_mm), _blob(outcome.in_force_um),
            None if m is None else _blob(m.errors), None if m is None else _blob(m.sigma), outcome.residual_um,
            outcome.reason,
        )  # fmt: skip
        self._put("INSERT INTO measurement VALUES (NULL, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)", [row], commit=True)

    def models(self, models: ModelSet, after_k: int) -> None:
        row = (after_k, models.fingerprint(), json.dumps(models.to_dict()))
        self._put("INSERT INTO model VALUES (NULL, ?, ?, ?)", [row], commit=True)

    def event(self, event: Event, k: int | None) -> None:
        time_ = self._clock.utc().isoformat()
        row = (time_, k, event.kind.value, event.text, event.error, event.value, event.limit)
        self._put("INSERT INTO event VALUES (NULL, ?, ?, ?, ?, ?, ?, ?)", [row])

    def compensation(self, write: Write) -> None:
        row = (
            write.time.isoformat(), write.mode, write.step.source.value, write.k, _blob(write.step.target_um),
            _blob(write.step.offsets_um), json.dumps(dict(write.positions)), int(write.written),
            None if write.read_back_um is None else _blob(write.read_back_um), _blob(write.step.coefficients_um),
        )  # fmt: skip
        self._put("INSERT INTO compensation VALUES (NULL, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)", [row])

    def sensors(self, judgement: Judgement, k: int) -> None: ...

    def probing(self, outlook: Outlook) -> None:
        """Not kept: what blocks probing and what an operator should know are events."""

    # Writing ---------------------------------------------------------------------------------------------------------

    def _put(self, statement: str, rows: Sequence[Sequence[object]], *, commit: bool = False) -> None:
        if self._failure is not None:
            raise StoreError(f"{self._path}: {self._failure}") from self._failure
        self._queue.put((statement, rows, commit))

    def _write(self) -> None:
        try:
            with closing(connect(self._path)) as connection:
                self._write_to(connection)
        except BaseException as error:  # noqa: BLE001 - handed to the caller by the next call
            self._failure = error
            while not (self._closing and self._queue.empty()):  # no producer may wait for a writer that is gone
                with suppress(queue.Empty):
                    self._queue.get(timeout=_DRAIN_S)
                    self._queue.task_done()

    def _prune(self, connection: sqlite3.Connection) -> None:
        oldest = self._clock.utc() - timedelta(seconds=self._keep_s)
        connection.execute("DELETE FROM sample WHERE time < ?", (oldest.timestamp(),))
        connection.execute("DELETE FROM compensation WHERE time < ?", (oldest.isoformat(),))

    def _write_to(self, connection: sqlite3.Connection) -> None:
        self._prune(connection)
        connection.commit()
        committed = pruned = time.monotonic()
        while True:
            try:
                item = self._queue.get(timeout=self._commit_s)
            except queue.Empty:
                connection.commit()
                continue
            try:
                if item is None:
                    connection.commit()
                    return
                statement, rows, commit = item
                if statement:
                    connection.executemany(statement, rows)
                now = time.monotonic()
                if now - pruned >= _PRUNE_EVERY_S:
                    self._prune(connection)
                    pruned = now
                if (commit and self._queue.empty()) or now - committed >= self._commit_s:
                    connection.commit()
                    committed = now
            finally:
                self._queue.task_done()  # also of what failed, or `flush` would wait for ever


def _next_boot(path: Path) -> int:
    """Number of this run in this file: readings carry it instead of the long boot id."""
    with closing(connect(path)) as connection:
        row = connection.execute(
            "SELECT max(coalesce((SELECT max(number) FROM boot), 0), coalesce((SELECT max(boot) FROM sample), 0))"
        ).fetchone()
    return int(row[0]) + 1


class History:
    """Reads a database, also while a gateway writes to it. A context manager.

    Raises StoreError when the file is not a database of this gateway.
    """

    def __init__(self, path: Path) -> None:
        if not path.is_file():
            raise StoreError(f"{path}: no such file")
        self._path = path
        self._connection = sqlite3.connect(path, timeout=10.0)
        try:
            version = self._connection.execute("PRAGMA user_version").fetchone()[0]
        except sqlite3.DatabaseError as error:
            self._connection.close()
            raise StoreError(f"{path}: is not a database of this gateway: {error}") from error
        if version != SCHEMA_VERSION:
            self._connection.close()
            raise StoreError(f"{path}: schema version {version}, expected {SCHEMA_VERSION}")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._connection.close()

    def config(self) -> tuple[str, str, str] | None:
        """Canonical configuration, its fingerprint and the versions of the latest run; what a reload left running."""
        row = self._connection.execute(
            "SELECT config, fingerprint, versions, number FROM boot ORDER BY number DESC LIMIT 1"
        ).fetchone()
        if row is None:
            return None
        config, fingerprint, versions, boot = row
        latest = [(text, mark) for number, _, text, mark in self._running() if number == boot][-1:]
        config, fingerprint = latest[0] if latest else (config, fingerprint)
        return str(config), str(fingerprint), str(versions)

    def fingerprints(self) -> list[tuple[datetime, str]]:
        """UTC and fingerprint of each configuration that began to run, by a start or a reload; oldest first."""
        return [(datetime.fromisoformat(began), fingerprint) for _, began, _, fingerprint in self._running()]

    def last_number(self) -> int | None:
        """Of the last probing request, whatever became of it."""
        numbers = self._connection.execute("SELECT number FROM measurement ORDER BY id DESC LIMIT 1").fetchall()
        if self._has("request"):  # written before the cycle is asked for, the measurement when it has ended
            numbers = self._connection.execute("SELECT number FROM request").fetchall() or numbers
        return int(numbers[0][0]) if numbers else None

    def _has(self, table: str) -> bool:
        """False in a file of an earlier program."""
        known = "SELECT count(*) FROM sqlite_master WHERE name = ?"
        return bool(self._connection.execute(known, (table,)).fetchone()[0])

    def _running(self) -> list[tuple[int, str, str, str]]:
        """Number of the run, UTC, configuration, fingerprint; none in a file of an earlier program."""
        if not self._has("running"):
            return []
        return self._connection.execute("SELECT boot, began, config, fingerprint FROM running ORDER BY id").fetchall()

    def steps(self) -> Iterator[StoredStep]:
        """Every grid step, oldest first."""
        adopted: dict[int, list[ModelSet]] = {}
        for after_k, text in self._connection.execute("SELECT after_k, models FROM model ORDER BY id"):
            adopted.setdefault(after_k, []).append(ModelSet.from_dict(json.loads(text)))
        rows = self._connection.execute(
            "SELECT f.k, f.inputs, f.valid, f.errors, f.sigma, d.phase, d.predicted, d.corrected, d.sigma, d.limits,"
            " d.measure, d.training, d.events FROM frame f JOIN decision d ON d.k = f.k ORDER BY f.k"
        )
        for row in rows:
            inputs = _array(row[1])
            measurement = None if row[3] is None else Measurement(_array(row[3]), _array(row[4]))
            frame = Frame(row[0], inputs, _mask(row[2], inputs.size), measurement)
            decision = Decision(
                k=row[0], phase=Phase(row[5]), predicted=_array(row[6]), corrected=_array(row[7]),
                sigma=_array(row[8]), limits=_array(row[9]), measure=None if row[10] is None else Why(row[10]),
                training=None, events=tuple(_event(e) for e in json.loads(row[12])),
            )  # fmt: skip
            yield StoredStep(frame, decision, row[11], tuple(adopted.get(row[0], ())))

    def measurements(self) -> list[StoredMeasurement]:
        """Every probing cycle, oldest first; `centres_mm` has three columns."""
        rows = self._connection.execute(
            "SELECT number, why, ended, centres, in_force, errors, reason FROM measurement ORDER BY id"
        )
        return [
            StoredMeasurement(
                n, why, datetime.fromisoformat(ended), None if c is None else _array(c).reshape(-1, 3),
                _array(force).reshape(-1, 3).squeeze(),
                None if e is None else _array(e), reason,
            )
            for n, why, ended, c, force, e, reason in rows
        ]  # fmt: skip

    def events(self) -> list[tuple[datetime, int | None, Event]]:
        """Every event, oldest first."""
        rows = self._connection.execute("SELECT time, k, kind, text, error, value, bound FROM event ORDER BY id")
        return [(datetime.fromisoformat(t), k, _event(rest)) for t, k, *rest in rows]

    def compensation(self) -> list[StoredCompensation]:
        """Every step of the compensation, oldest first."""
        rows = self._connection.execute("SELECT time, mode, source, offsets, written FROM compensation ORDER BY id")
        return [
            StoredCompensation(datetime.fromisoformat(t), mode, source, _array(o), bool(w))
            for t, mode, source, o, w in rows
        ]

    def channel_health(self) -> dict[str, dict[str, int]]:
        """Channel to the number of stored readings of each quality."""
        found: dict[str, dict[str, int]] = {}
        rows = self._connection.execute("SELECT channel, quality, count(*) FROM sample GROUP BY channel, quality")
        for channel, quality, count in rows:
            found.setdefault(channel, {})[quality] = count
        return found


def _mask(blob: bytes, size: int) -> BoolArray:
    return np.unpackbits(np.frombuffer(blob, dtype=np.uint8), count=size).astype(np.bool_)


def _event(parts: Sequence[Any]) -> Event:
    kind, text, error, value, limit = parts
    return Event(EventKind(kind), text, error, value, limit)


def boot_id() -> str:
    """A name for this run of the process, from the kernel."""
    return Path("/proc/sys/kernel/random/uuid").read_text(encoding="ascii").strip()


def utc_of(k: int, step_s: float) -> datetime:
    """UTC of a grid index."""
    return datetime.fromtimestamp(k * step_s, UTC)
