"""The estimates and measurements of a span of time, thinned: bounded work, however long the span is."""

import sqlite3
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

import numpy as np

from gateway.config.outline import inputs_of_config
from gateway.storage.faults import DamagedError
from gateway.storage.pages import reading_connection
from gateway.storage.placing import placed_frames
from gateway.storage.rows import frames_of, reasons_of
from talc.explanation import Reasons
from talc.frame import EventKind, FloatArray
from talc.names import THERMAL_ERRORS

_ERRORS = len(THERMAL_ERRORS)
_TEMPERATURE = "degC"
_MOST_MEASUREMENTS = 20_000
"""Rows that are looked at for one answer; of more, the latest."""

_MARKED = (EventKind.PROBLEM, EventKind.MEASUREMENT_REJECTED, EventKind.MODEL_REJECTED, EventKind.SENSOR_SUSPECT,
           EventKind.OPERATOR, EventKind.COMMAND)  # fmt: skip
"""Kinds of events that somebody looks for months later."""
_MOST_MARKED = 1000

_Measured = tuple[str, bytes, bytes | None, float | None, bytes]
"""When it ended, errors, sigma, residual, and what was in force."""


@dataclass(frozen=True, slots=True, eq=False)
class StoredReasons:
    """Why the learner corrected as it did at one step."""

    time: float
    """When it said so, UTC, seconds since 1970."""
    reasons: Reasons
    sigma: FloatArray
    """(9,) of the decision of that step; NaN: none is stored."""
    measured: datetime | None
    """When the last measurement that was used had ended; None: there was none."""


@dataclass(frozen=True, slots=True, eq=False)
class StoredCourse:
    """n estimates and m measurements, oldest first; times are UTC, seconds since 1970."""

    time: FloatArray
    """(n,)"""
    corrected: FloatArray
    """(n, 9) the estimate; likewise its sigma."""
    sigma: FloatArray
    measured_time: FloatArray
    """(m,)"""
    measured: FloatArray
    """(m, 9); likewise measured_sigma."""
    measured_sigma: FloatArray
    residual_um: FloatArray
    """(m,) RMS of what the nine errors do not explain; NaN: unknown."""
    temperature_names: tuple[str, ...]
    """Inputs in degC of the latest run; t of them, none unless they were asked for."""
    temperatures: FloatArray
    """(n, t) at the times of the estimates; NaN: no good value."""
    reasons: tuple[StoredReasons, ...]
    """The latest of the span, oldest first; none unless they were asked for."""
    other_names: tuple[str, ...]
    """The other inputs of the latest run, such as loads; o of them, none unless they were asked for."""
    others: FloatArray
    """(n, o) likewise."""
    left: FloatArray
    """(m, 9) what each measurement found beyond what was predicted and in force; NaN: unknown."""
    marked: tuple[tuple[float, str], ...]
    """When a problem or an order was, and its kind; the latest of the span."""


def course_between(
    path: Path,
    begin: datetime,
    end: datetime,
    most: int,
    step_s: float,
    *,
    temperatures: bool = False,
    reasons: bool = False,
    inputs: bool = False,
) -> StoredCourse:
    """The estimates from `begin` on and before `end`: of at most `most` equal parts of the span, each one's first; and
    the measurements that were used, evenly thinned to as many. If asked for, also the latest reasons, as many.

    most: at least 1
    step_s: grid step

    Raises StoreError if the database cannot be read.
    """
    with reading_connection(path) as connection:
        first, behind = (int(-(-time.timestamp() // step_s)) for time in (begin, end))
        found = list(_decisions(connection, first, behind, most))
        measured = _thinned(_measurements(connection, begin, end), most)
        given = _reasons(connection, begin, end, most, step_s) if reasons else ()
        at = [k for k, *_ in found]
        nothing: tuple[tuple[str, ...], FloatArray] = (), np.empty((len(at), 0))
        degrees = _inputs(connection, at, "temperatures") if temperatures else nothing
        others = _inputs(connection, at, "others") if inputs else nothing
        left = _left(connection, measured, step_s)
        marked = _marked(connection, begin, end)
    return StoredCourse(
        np.array([k * step_s for k, *_ in found]),
        _nines([row[1] for row in found]),
        _nines([row[2] for row in found]),
        np.array([datetime.fromisoformat(row[0]).timestamp() for row in measured]),
        _nines([row[1] for row in measured]),
        _nines([row[2] for row in measured]),
        np.array([np.nan if row[3] is None else row[3] for row in measured], dtype=np.float64),
        *degrees,
        given,
        *others,
        left,
        marked,
    )


def _decisions(
    connection: sqlite3.Connection, first: int, behind: int, most: int
) -> Iterator[tuple[int, bytes, bytes]]:
    part, k = -(-max(behind - first, 1) // most), first
    while k < behind:
        found = connection.execute(
            "SELECT k, corrected, sigma FROM decision WHERE k >= ? AND k < ? ORDER BY k LIMIT 1", (k, behind)
        ).fetchone()
        if found is None:
            return
        yield found
        k = first + ((found[0] - first) // part + 1) * part


def _measurements(connection: sqlite3.Connection, begin: datetime, end: datetime) -> list[_Measured]:
    """Times are stored as text, in UTC, which sorts as they do."""
    rows = connection.execute(
        "SELECT ended, errors, sigma, residual, in_force FROM measurement"
        f" WHERE errors IS NOT NULL AND ended >= ? AND ended < ? ORDER BY id DESC LIMIT {_MOST_MEASUREMENTS}",
        [time.astimezone(UTC).isoformat() for time in (begin, end)],
    )
    return rows.fetchall()[::-1]


def _marked(connection: sqlite3.Connection, begin: datetime, end: datetime) -> tuple[tuple[float, str], ...]:
    rows = connection.execute(
        f"SELECT time, kind FROM event WHERE kind IN ({','.join('?' * len(_MARKED))})"
        f" AND time >= ? AND time < ? ORDER BY id DESC LIMIT {_MOST_MARKED}",
        [*_MARKED, *(time.astimezone(UTC).isoformat() for time in (begin, end))],
    ).fetchall()
    return tuple((datetime.fromisoformat(time).timestamp(), kind) for time, kind in reversed(rows))


def _reasons(
    connection: sqlite3.Connection, begin: datetime, end: datetime, most: int, step_s: float
) -> tuple[StoredReasons, ...]:
    """A step is explained when it ends, so none before `end` has a higher index than the one that ends after it."""
    if connection.execute("SELECT 1 FROM sqlite_master WHERE name = 'reasons'").fetchone() is None:
        return ()  # of an earlier program
    rows = connection.execute(
        "SELECT r.k, r.time, r.reasons, d.sigma FROM reasons r LEFT JOIN decision d ON d.k = r.k"
        " WHERE r.k <= ? AND r.time >= ? AND r.time < ? ORDER BY r.k DESC LIMIT ?",
        (int(end.timestamp() // step_s) + 1, begin.timestamp(), end.timestamp(), most),
    ).fetchall()
    return tuple(
        StoredReasons(time, reasons_of(text), _nines([sigma])[0], _used_before(connection, time))
        for _, time, text, sigma in reversed(rows)
    )


def _used_before(connection: sqlite3.Connection, time: float) -> datetime | None:
    last = "SELECT ended FROM measurement WHERE errors IS NOT NULL AND ended <= ? ORDER BY id DESC LIMIT 1"
    row = connection.execute(last, (datetime.fromtimestamp(time, UTC).isoformat(),)).fetchone()
    return None if row is None else datetime.fromisoformat(row[0])


def _thinned(rows: Sequence[_Measured], most: int) -> Sequence[_Measured]:
    if len(rows) <= most:
        return rows
    return [rows[i] for i in np.linspace(0, len(rows) - 1, most).round().astype(int)]


def _left(connection: sqlite3.Connection, measured: Sequence[_Measured], step_s: float) -> FloatArray:
    """(m, 9) measured less predicted, by the decision on the step that took it over, which did not know it yet; all of
    it where nothing was in force."""
    found = _nines([row[1] for row in measured])
    query = (
        "SELECT d.predicted FROM frame f JOIN decision d ON d.k = f.k"
        " WHERE f.k >= ? AND f.k < ? AND f.errors IS NOT NULL ORDER BY f.k LIMIT 1"
    )
    for left, (ended, *_, in_force) in zip(found, measured, strict=True):
        if any(in_force):
            k = int(datetime.fromisoformat(ended).timestamp() // step_s)
            left -= _nines([row[0] if (row := connection.execute(query, (k, k + 3)).fetchone()) else None])[0]
    return found


def _inputs(
    connection: sqlite3.Connection, wanted: Sequence[int], of: Literal["temperatures", "others"]
) -> tuple[tuple[str, ...], FloatArray]:
    """Names and values (n, t) at these grid indices."""
    runs = connection.execute("SELECT id, config FROM boot ORDER BY number")
    own = {boot: inputs_of_config(config) for boot, config in runs}
    units = dict(connection.execute("SELECT name, unit FROM channel").fetchall())
    latest = next(reversed(own.values()), ())
    names = tuple(name for name in latest if (units.get(name) == _TEMPERATURE) == (of == "temperatures"))
    values = np.full((len(wanted), len(names)), np.nan)
    frame = "SELECT k, inputs, valid, errors, boot FROM frame WHERE k = ?"
    for into, k in zip(values, wanted, strict=True):
        row = connection.execute(frame, (k,)).fetchone()
        if row is not None and (inputs := own.get(row[-1])):
            placed = placed_frames(frames_of([row[:-1]]), inputs, names)
            into[:] = np.where(placed.valid[0], placed.inputs[0], np.nan)
    return names, values


def _nines(blobs: Sequence[bytes | None]) -> FloatArray:
    """(n, 9); a row that is not stored is unknown."""
    values = np.full((len(blobs), _ERRORS), np.nan)
    for row, blob in zip(values, blobs, strict=True):
        if blob is not None:
            if len(blob) != 8 * _ERRORS:
                raise DamagedError("a row of nine errors has another length")
            row[:] = np.frombuffer(blob, dtype="<f8")
    return values
