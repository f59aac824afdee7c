"""Reads a database, even while a gateway writes to it."""

import sqlite3
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from itertools import groupby
from pathlib import Path
from typing import Any, Self

import numpy as np

from gateway.config.outline import inputs_of_config
from gateway.model.commands import CommandName, CommandOutcome, Disarmed, Pause
from gateway.model.step_time import StepTime
from gateway.model.text import Text, plain
from gateway.storage import rows
from gateway.storage.answers import DiskWork
from gateway.storage.faults import StoreError
from gateway.storage.pages import first_id
from gateway.storage.placing import placed_frames, placed_step
from gateway.storage.readings import EARLIER, counts
from gateway.storage.schema import EXPORTED, READABLE, SCHEMA_VERSION, shown_as, unusable
from gateway.storage.stored import StoredCompensation, StoredMeasurement, StoredRun, StoredStep
from talc.explanation import Reasons
from talc.frame import Event, EventKind, Frames, Why
from talc.models import ModelSet
from talc.names import THERMAL_ERRORS

_ALL = 2**63 - 1
_WIDER = timedelta(minutes=2)
"""Rows of one moment may be stored in another order."""
TimeSpan = tuple[datetime, datetime]
"""From one instant on, until before another."""


def _opened(path: Path) -> sqlite3.Connection:
    """A connection that any one thread may use. Raises StoreError."""
    if not path.is_file():
        raise StoreError(f"{path}: no such file")
    connection = sqlite3.connect(path, timeout=10.0, check_same_thread=False)
    try:
        (version,) = connection.execute("PRAGMA user_version").fetchone()
        (tables,) = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
    except sqlite3.DatabaseError as error:
        connection.close()
        raise unusable(path, error) from error
    if version not in READABLE:
        connection.close()
        raise StoreError(f"{path}: {_unreadable(version, tables)}")
    return connection


def _unreadable(version: int, tables: int) -> str:
    if version == 0 and not tables:
        return "is empty: no gateway has stored anything in it; [storage] path in the configuration names the database"
    if version == 0:
        return "is the database of another program; [storage] path in the configuration names the gateway's"
    if 0 < version < min(READABLE):
        return f"is of an earlier program (schema version {version}); `talc-gateway run` brings it to the present one"
    return f"states schema version {version}, this program reads {min(READABLE)} to {SCHEMA_VERSION}: use a newer one"


class History:
    """One database, as a context manager.

    Raises StoreError if the file is not a database of this gateway, or its disk does not answer.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._connection = DiskWork(path, lambda: _opened(path), unwanted=sqlite3.Connection.close).wait()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._connection.close()

    def config(self) -> tuple[str, str, str] | None:
        """Canonical configuration, fingerprint and versions of the latest run, after its reloads."""
        row = self._connection.execute(
            "SELECT config, fingerprint, versions, number FROM boot ORDER BY number DESC LIMIT 1"
        ).fetchone()
        if row is None:
            return None
        config, fingerprint, versions, boot = row
        latest = [(text, mark) for number, text, mark in self._running() if number == boot][-1:]
        config, fingerprint = latest[0] if latest else (config, fingerprint)
        return str(config), str(fingerprint), str(versions)

    def configs(self) -> list[str]:
        """Copies of the canonical configuration of the latest run, after its reloads the present one first."""
        latest = self.config()
        starts = self._connection.execute("SELECT config FROM boot ORDER BY number DESC LIMIT 1").fetchall()
        return [] if latest is None else list(dict.fromkeys([latest[0], *(str(text) for (text,) in starts)]))

    def starts(self) -> list[StoredRun]:
        """Every start of the gateway, oldest first."""
        return [rows.run_of(row) for row in self._connection.execute(f"SELECT {rows.RUN_COLUMNS} FROM boot ORDER BY 1")]

    def runs(self) -> list[tuple[int, str, str | None]]:
        """First grid index, canonical configuration and prior of each run that made a frame, oldest first."""
        found = self._connection.execute(
            "SELECT min(f.k), b.config, b.number FROM frame f JOIN boot b ON b.id = f.boot GROUP BY b.number ORDER BY 1"
        ).fetchall()
        return [(first_k, config, self._prior(number)) for first_k, config, number in found]

    def prior(self) -> str | None:
        """Text of the prior of the latest run; None if it had none."""
        latest = self._connection.execute("SELECT max(number) FROM boot").fetchone()[0]
        return None if latest is None else self._prior(latest)

    def _prior(self, boot: int) -> str | None:
        if not self._has("prior_of_boot"):
            return None
        return self._content("prior_of_boot b JOIN prior p ON p.hash = b.hash WHERE b.boot = ?", boot)

    def last_number(self) -> int | None:
        """Number of the last probing request, whatever its outcome."""
        numbers = self._connection.execute("SELECT number FROM measurement ORDER BY id DESC LIMIT 1").fetchall()
        if self._has("request"):  # written before the cycle is requested; the measurement is written after it
            numbers = self._connection.execute("SELECT number FROM request").fetchall() or numbers
        return int(numbers[0][0]) if numbers else None

    def cycle_asked(self) -> datetime | None:
        """When the latest run asked for the probing cycle of which no end is stored; None: none is in progress."""
        if not self._has("request"):
            return None
        open_ones = self._connection.execute(
            "SELECT asked FROM request WHERE asked >= (SELECT began FROM boot ORDER BY number DESC LIMIT 1)"
            " AND number NOT IN (SELECT number FROM measurement ORDER BY id DESC LIMIT 1)"
        ).fetchall()
        return datetime.fromisoformat(open_ones[0][0]) if open_ones else None

    def _has(self, table: str) -> bool:
        """Whether the table exists; not in a file of an earlier program."""
        known = "SELECT count(*) FROM sqlite_master WHERE name = ?"
        return bool(self._connection.execute(known, (table,)).fetchone()[0])

    def _running(self) -> list[tuple[int, str, str]]:
        """Number of the run, configuration, fingerprint; empty for a file of an earlier program."""
        if not self._has("running"):
            return []
        return self._connection.execute("SELECT boot, config, fingerprint FROM running ORDER BY id").fetchall()

    def snapshots(self) -> Iterator[bytes]:
        """Those taken at steps that are stored, the latest first; gateway.storage.snapshot decodes them.

        None from before what stands for steps that were lost: it would lack what was learnt at these.
        """
        if self._has("snapshot"):
            stands = self.learnt()
            found = "SELECT CAST(state AS BLOB) FROM snapshot WHERE k IN (SELECT k FROM decision)"
            found += " AND k >= ? ORDER BY k DESC"
            yield from (state for (state,) in self._connection.execute(found, (-1 if stands is None else stands[1],)))

    def frames(self, names: Sequence[str], first_k: int, last_k: int) -> Frames:
        """The frames from one grid index to another one, both included, with these inputs."""
        found = self._connection.execute(
            "SELECT k, inputs, valid, errors, boot FROM frame WHERE k BETWEEN ? AND ? ORDER BY k", (first_k, last_k)
        )
        own = self._inputs()
        parts = [
            placed_frames(rows.frames_of(list(group)), own.get(boot), names)
            for boot, group in groupby(found, key=lambda row: row[4])
        ]
        if not parts:
            nothing = np.empty((0, len(names)))
            return Frames(np.empty(0, np.int64), nothing, nothing.astype(np.bool_), np.empty((0, len(THERMAL_ERRORS))))
        return Frames(
            k=np.concatenate([part.k for part in parts]),
            inputs=np.concatenate([part.inputs for part in parts]),
            valid=np.concatenate([part.valid for part in parts]),
            measured=np.concatenate([part.measured for part in parts]),
        )

    def _inputs(self) -> dict[str, tuple[str, ...]]:
        """Names of the inputs of each run, by its id."""
        return {boot: inputs_of_config(text) for boot, text in self._connection.execute("SELECT id, config FROM boot")}

    def suspect_since(self) -> int | None:
        """Grid index since when sensors are suspect; None: they agree."""
        since = None
        found = "SELECT kind, k FROM event WHERE kind IN (?, ?) ORDER BY id DESC"
        for kind, k in self._connection.execute(found, (EventKind.SENSOR_SUSPECT, EventKind.SENSORS_AGREE)):
            if kind == EventKind.SENSORS_AGREE:
                break
            since = k
        return since

    def steps(self, after_k: int = -1, names: Sequence[str] | None = None, last_k: int = _ALL) -> Iterator[StoredStep]:
        """Every grid step after one, until `last_k`, oldest first, with these inputs (None: those that it had)."""
        own = {} if names is None else self._inputs()
        adopted: dict[int, list[ModelSet]] = {}
        newer = "SELECT after_k, models FROM model WHERE after_k > ? AND after_k <= ? ORDER BY id"
        for k, text in self._connection.execute(newer, (after_k, last_k)):
            adopted.setdefault(k, []).append(rows.models_of(text))
        trusted, trust = ("t.trusted", "LEFT JOIN trust t ON t.k = f.k") if self._has("trust") else ("NULL", "")
        found = self._connection.execute(
            f"SELECT {rows.STEP_COLUMNS}, {trusted}, f.boot FROM frame f JOIN decision d ON d.k = f.k {trust}"
            " WHERE f.k > ? AND f.k <= ? ORDER BY f.k",
            (after_k, last_k),
        )
        last, pauses = after_k, set(self.pauses())
        for row in found:
            if row[0] <= last:  # of a damaged page
                raise ValueError(f"{self._path}: step {row[0]} follows step {last}")
            last = row[0]
            step = rows.step_of(row[:-1], adopted.get(row[0], ()))
            if last in pauses:
                step = replace(step, frame=replace(step.frame, pause_unknown=True))
            yield step if names is None else placed_step(step, own.get(row[-1]), names)

    def pauses(self, *, uncovered: bool = False) -> list[int]:
        """Grid indices of frames before which the time was not known.

        uncovered: only those that no later index makes up for
        """
        if not self._has("pause"):
            return []
        where = " WHERE NOT known" if uncovered else ""
        return [k for (k,) in self._connection.execute(f"SELECT k FROM pause{where} ORDER BY k")]

    def moment(self) -> StepTime | None:
        """What the clocks said at the last frame; an earlier program's is taken for numbered by a clock that was right.

        What was learnt without them is of an unknown time. None: there is neither a frame nor anything that was learnt.
        """
        row = self._connection.execute("SELECT * FROM moment").fetchone() if self._has("moment") else None
        last_k, learnt = self.latest_k(), self.learnt()
        if learnt is not None and (last_k is None or last_k < learnt[1]):
            return StepTime(learnt[1], "", 0.0, 0.0, known=False)
        if row is not None:
            _, k, origin, monotonic_s, lead_s, known = row
            return StepTime(k, origin, monotonic_s, lead_s, bool(known))
        if last_k is not None:
            return StepTime(last_k, "", 0.0, 0.0, known=True)
        return None

    def learnt(self) -> tuple[str, int] | None:
        """What stands for the steps until a grid index (`gateway.storage.learnt`), and this index; -1: it was imported
        before the first step. None: the steps alone tell what was learnt."""
        if not self._has("learnt"):
            return None
        row = self._connection.execute("SELECT content, slot - 1 FROM learnt").fetchone()
        return None if row is None else (str(row[0]), int(row[1]))

    def _content(self, source: str, *values: object) -> str | None:
        """The text in the first row of a table or a join; None: it has no row."""
        row = self._connection.execute(f"SELECT content FROM {source}", values).fetchone()
        return None if row is None else str(row[0])

    def reasons(self, last_k: int = _ALL) -> Reasons | None:
        """The latest ones, until this grid index; None: none were given."""
        if not self._has("reasons"):
            return None
        latest = "SELECT reasons FROM reasons WHERE k <= ? ORDER BY k DESC LIMIT 1"
        row = self._connection.execute(latest, (last_k,)).fetchone()
        return None if row is None else rows.reasons_of(row[0])

    def reasons_given(self, after_k: int = -1, last_k: int = _ALL) -> Iterator[Reasons]:
        """All that are stored after one grid index, until another, oldest first."""
        if self._has("reasons"):
            within = "SELECT reasons FROM reasons WHERE k > ? AND k <= ? ORDER BY k"
            yield from (rows.reasons_of(r) for (r,) in self._connection.execute(within, (after_k, last_k)))

    def units(self) -> dict[str, str]:
        """Channel to the unit of its readings; nothing from an earlier program's file."""
        if not self._has("channel"):
            return {}
        return dict(self._connection.execute("SELECT name, unit FROM channel ORDER BY id").fetchall())

    def reference(self) -> StoredMeasurement | None:
        """The measurement that errors count from: the first that was used, or the latest new reference for which a
        person asked. That one has no errors while no step has taken it over: it is still to be measured, or again."""
        row = self._connection.execute(f"SELECT {rows.MEASUREMENT_COLUMNS} FROM ({rows.REFERENCE})").fetchone()
        if row is None:
            return None
        found = rows.measurement_of(row)
        if found.why != Why.REFERENCE:
            return found
        taken = "SELECT count(*) FROM event WHERE kind = ? AND time >= ?"
        given = EventKind.NEW_REFERENCE.value, _stored_time(found.ended)
        return found if self._connection.execute(taken, given).fetchone()[0] else replace(found, errors=None)

    def measurements(self, within: TimeSpan | None = None) -> list[StoredMeasurement]:
        """Every probing cycle, or those that ended in a span, oldest first; `centres_mm` has three columns."""
        columns = f"{rows.MEASUREMENT_COLUMNS}, {rows.CODE_OF_REASON if self._has('coded') else rows.NO_CODE}"
        return [rows.coded_measurement_of(row) for row in self._rows(columns, "measurement", "ended", within)]

    def residuals_um(self) -> list[float]:
        """What no rigid body explains of each measurement that was used, RMS, µm, oldest first."""
        found = "SELECT residual FROM measurement WHERE errors IS NOT NULL AND residual IS NOT NULL ORDER BY id"
        return [float(residual) for (residual,) in self._connection.execute(found)]

    def latest_k(self) -> int | None:
        """Grid index of the latest frame."""
        return self._connection.execute("SELECT max(k) FROM frame").fetchone()[0]  # type: ignore[no-any-return]

    def latest_decision(self) -> tuple[int, str] | None:
        """Grid index and phase."""
        row = self._connection.execute("SELECT k, phase FROM decision ORDER BY k DESC LIMIT 1").fetchone()
        return None if row is None else (int(row[0]), str(row[1]))

    def latest_readings(self, since: datetime) -> dict[str, tuple[float | None, str, str]]:
        """Channel to its latest value, unit and quality, of what the latest run has read since then."""
        found = (
            "SELECT channel, value, unit, quality, max(time) FROM sample"
            " WHERE time >= ? AND boot = (SELECT max(number) FROM boot) GROUP BY channel"
        )
        return {row[0]: row[1:4] for row in self._connection.execute(found, (since.timestamp(),))}

    def events(self, within: TimeSpan | None = None) -> list[tuple[datetime, int | None, Event]]:
        """Every event, or those of a span, oldest first."""
        return [rows.coded_event_of(row) for row in self._rows(self._event_columns, "event", "time", within)]

    def troubles(self) -> list[tuple[datetime, Event]]:
        """Problems and their ends since the latest run began, or took another configuration, oldest first."""
        changed = " UNION SELECT began FROM running" if self._has("running") else ""
        found = self._connection.execute(
            f"SELECT {self._event_columns} FROM event WHERE kind IN (?, ?)"
            f" AND time >= (SELECT max(began) FROM (SELECT began FROM boot{changed})) ORDER BY id",
            (EventKind.PROBLEM.value, EventKind.PROBLEM_ENDED.value),
        )
        return [(at, event) for at, _, event in map(rows.coded_event_of, found)]

    @property
    def _event_columns(self) -> str:
        return f"{rows.EVENT_COLUMNS}, {rows.CODE_OF_EVENT if self._has('coded') else rows.NO_CODE}"

    def operator_texts(self) -> list[Text]:
        """What operators were told, newest first."""
        found = f"SELECT {self._event_columns} FROM event WHERE kind = ? ORDER BY id DESC"
        told = self._connection.execute(found, (EventKind.OPERATOR.value,))
        return [plain(event.text) for _, _, event in map(rows.coded_event_of, told)]

    def configs_that_measured(self) -> list[str]:
        """Canonical configurations of the runs in which a measurement was used, newest first.

        A reference that a repair put back is before the first row, and counts for the first run that is left.
        """
        first = "m.id < 0 AND number = (SELECT min(number) FROM boot)"
        ran = f"SELECT max(number) FROM boot WHERE began <= m.ended OR ({first})"
        found = self._connection.execute(
            f"SELECT config FROM boot WHERE number IN (SELECT DISTINCT ({ran}) FROM measurement m"
            " WHERE errors IS NOT NULL) ORDER BY number DESC"
        )
        return list(dict.fromkeys(str(text) for (text,) in found))

    def config_at(self, time: datetime) -> str | None:
        """Canonical configuration of the run at this time, or of the first one; None: no run is stored."""
        ran = "coalesce((SELECT max(number) FROM boot WHERE began <= ?), (SELECT min(number) FROM boot))"
        row = self._connection.execute(
            f"SELECT config FROM boot WHERE number = {ran}", (_stored_time(time),)
        ).fetchone()
        return None if row is None else str(row[0])

    def commands(self) -> list[CommandOutcome]:
        """Every command that somebody gave, oldest first."""
        if not self._has("command"):
            return []
        found = self._connection.execute(f"SELECT {rows.COMMAND_COLUMNS} FROM command ORDER BY id")
        return [rows.command_of(row) for row in found]

    def paused(self) -> Pause | None:
        """The pause that was not resumed; None: there is none."""
        first = self._standing(CommandName.PAUSE)
        return None if first is None else Pause(first.command.by, first.time)

    def disarmed(self) -> Disarmed | None:
        """Who has disarmed the gateway; None: nobody, or it was armed again."""
        first = self._standing(CommandName.DISARM)
        return None if first is None else Disarmed(first.command.by, first.time)

    def _standing(self, name: CommandName) -> CommandOutcome | None:
        row = self._connection.execute(rows.STANDING[name]).fetchone() if self._has("command") else None
        return None if row is None else rows.command_of(row)

    def compensation(self, within: TimeSpan | None = None) -> list[StoredCompensation]:
        """Every step of the compensation, or those of a span, oldest first; of a span, those before the clock was set
        back may be missed."""
        if within is None:
            found = self._rows(rows.COMPENSATION_COLUMNS, "compensation", "time", None)
        else:  # there can be a million of them, without an index by time
            begin, end = (_stored_time(at) for at in (within[0] - _WIDER, within[1] + _WIDER))
            behind = self._connection.execute("SELECT coalesce(max(id), 0) + 1 FROM compensation").fetchone()[0]
            low = first_id(self._connection, "compensation", 1, behind, begin)
            high = first_id(self._connection, "compensation", low, behind, end)
            near = f"(SELECT * FROM compensation WHERE id >= {low} AND id < {high})"
            found = self._rows(rows.COMPENSATION_COLUMNS, near, "time", within)
        return [rows.compensation_of(row) for row in found]

    def _rows(self, columns: str, table: str, time: str, within: TimeSpan | None) -> sqlite3.Cursor:
        """In their order; times are stored as text in UTC, which sorts as they do."""
        if within is None:
            return self._connection.execute(f"SELECT {columns} FROM {table} ORDER BY id")
        return self._connection.execute(
            f"SELECT {columns} FROM {table} WHERE {time} >= ? AND {time} < ? ORDER BY id",
            [_stored_time(at) for at in within],
        )

    def readings(self) -> Iterator[tuple[Any, ...]]:
        """UTC timestamp, channel, value, unit, quality, detail, number of the run and of the read; oldest first."""
        columns = "time, channel, value, unit, quality, detail, boot, sequence"
        for table in (EARLIER, "sample"):
            if self._has(table):
                yield from self._connection.execute(f"SELECT {columns} FROM {table}")

    def minutes(self) -> Iterator[tuple[Any, ...]]:
        """UTC timestamp, channel, unit, count, mean, lowest and highest; a minute may be in two rows."""
        if self._has("minute"):
            yield from self._connection.execute(
                "SELECT m.time, c.name, c.unit, m.count, m.mean, m.low, m.high FROM minute m"
                " JOIN channel c ON c.id = m.channel ORDER BY m.id"
            )

    def sizes(self) -> list[tuple[str, int, int]]:
        """Name, rows and bytes of each table as exports call it, with all that belongs to it; the largest first. What
        only the gateway uses is `other`, without rows."""
        names = [n for (n,) in self._connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
        bytes_of = dict(
            self._connection.execute(
                "SELECT m.tbl_name, sum(s.pgsize) FROM dbstat s JOIN sqlite_master m ON m.name = s.name"
                " WHERE s.aggregate = TRUE GROUP BY 1"
            ).fetchall()
        )
        many, size = Counter[str](), Counter[str]()
        for n in names:
            if n in EXPORTED:
                many[EXPORTED[n]] += self._connection.execute(f'SELECT count(*) FROM "{n}"').fetchone()[0]
            size[shown_as(n)] += bytes_of.get(n, 0)
        return [(n, many[n], held) for n, held in size.most_common()]

    def span(self) -> tuple[int | None, int | None]:
        """Grid indices of the first and of the last frame; None: there is none."""
        first, last = self._connection.execute("SELECT min(k), max(k) FROM frame").fetchone()
        return first, last

    def free_bytes(self) -> int:
        """Size of the pages that new rows use before the file grows."""
        pages, size = (self._connection.execute(f"PRAGMA {n}").fetchone()[0] for n in ("freelist_count", "page_size"))
        return int(pages * size)

    def channel_health(self) -> dict[str, dict[str, int]]:
        """Channel to the number of stored readings of each quality."""
        found: dict[str, dict[str, int]] = {}
        rows_of = counts(self._connection) if self._has("reading") else []
        for table in ("sample", EARLIER):
            if self._has(table) and (table == EARLIER or not self._has("reading")):
                before = f"SELECT channel, quality, count(*) FROM {table} GROUP BY channel, quality"
                rows_of += self._connection.execute(before).fetchall()
        for channel, quality, count in rows_of:
            of_channel = found.setdefault(channel, {})
            of_channel[quality] = of_channel.get(quality, 0) + count
        return found


def _stored_time(time: datetime) -> str:
    return time.astimezone(UTC).isoformat()
