"""Sets a damaged database aside, and copies what can be read of it to a new one; replaces one that was deleted."""

import sqlite3
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field
from datetime import datetime
from itertools import count
from pathlib import Path
from typing import Any

from gateway.model.codes import NoticeCode
from gateway.model.commands import CommandName
from gateway.model.text import Text, Value
from gateway.storage import rows
from gateway.storage.damage import RawRow, any_text, checked_columns, inputs_of_run, is_whole
from gateway.storage.epochs import begin_epoch
from gateway.storage.imported import put_learnt, put_reference
from gateway.storage.leaf_pages import rows_cut_off, rows_in_pages
from gateway.storage.learnt import Learnt
from gateway.storage.outside import newest_outside
from gateway.storage.readings import MOST_BOOTS
from gateway.storage.schema import NEW, UNREADABLE
from talc.frame import Why

_LEARNT = ("frame", "decision", "measurement", "model")
_ALSO_LEARNT = ("trust", "reasons", "learnt")
_SAME_COMMAND = "SELECT 1 FROM command WHERE time = ? AND name = ? AND by = ?"
_FARTHEST = 2**40
_NUMBERS_SKIPPED = 100
"""Requests that may have been made after the last one that can be read."""


@dataclass(slots=True)
class Known:
    """Rows that the running gateway has in memory."""

    boot: RawRow | None = None
    """The row of this run."""
    first_k: int | None = None
    """The first of this run's steps; an earlier run's that was not read when this one began counts as lost."""
    reference: RawRow | None = None
    """The measurement that errors count from (rows.REFERENCE), without its id."""
    standing: dict[CommandName, RawRow] = field(default_factory=dict)
    """The command that stands until another one ends it; without its id."""


def mend(path: Path, why: str, now: datetime, known: Known) -> Text:
    """Set the file aside and begin a new one with what can be read. Returns what was done.

    No other program may have the file open. The new one is complete before it takes the place of the damaged one, so
    that nothing is lost if the disk fails meanwhile. Raises sqlite3.Error or OSError.
    """
    if known.reference is not None and not is_whole("measurement", (1, *known.reference)):
        known.reference = None  # it was read from the damaged file
    aside = path.with_name(f"{path.name}.damaged-{now:%Y%m%dT%H%M%S}")
    new = _fresh(path)
    with closing(sqlite3.connect(new)) as target:
        target.executescript(NEW)
        counts, lost = _copy(path, target)
        outside = newest_outside(path)
        reference_known = known.reference is not None
        if not reference_known and outside is not None:
            known.reference, reference_known = _reference_beside(target, outside[1])
        _restore(target, known)
        begun = _settle(target, counts, reference_known=reference_known)
        copied = outside is not None and known.boot is None and (begun or _knows_more(outside[1], target))
        if copied and outside is not None:
            put_learnt(target, outside[0], now, outside[1].last_k)
            if begun:
                put_reference(target, outside[1])
        lost += _recounted(target, counts)
        begin_epoch(target)
        target.commit()
    for ending in ("-wal", "-shm"):
        with suppress(FileNotFoundError):
            path.with_name(path.name + ending).rename(aside.with_name(aside.name + ending))
    try:
        aside.hardlink_to(path)  # so that there is a database at the path at any time
    except OSError:  # a file system without links
        path.rename(aside)
    new.replace(path)
    kept = ", ".join(f"{counts[table]} of {table}" for table in _LEARNT)
    coded = isinstance(why, Text) and why.code
    told: dict[str, Value] = {
        "path": str(path), "why": why if coded else " ".join(why.split()), "aside": aside.name, "kept": kept
    }  # fmt: skip
    if copied:
        return Text(NoticeCode.STORE_FROM_COPY, **told)
    if lost:
        return Text(NoticeCode.STORE_BEGUN_LOST if begun else NoticeCode.STORE_MENDED_LOST, **told, lost=lost)
    return Text(NoticeCode.STORE_BEGUN if begun else NoticeCode.STORE_MENDED, **told)


def begin_again(path: Path, known: Known) -> Text:
    """Begin another database in the place of one that was deleted. Returns what was done.

    Raises sqlite3.Error or OSError.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    new = _fresh(path)
    with closing(sqlite3.connect(new)) as target:
        target.executescript(NEW)
        _restore(target, known)
        begin_epoch(target)
        target.commit()
    for ending in ("-wal", "-shm"):  # of the deleted one
        path.with_name(path.name + ending).unlink(missing_ok=True)
    new.replace(path)
    return Text(NoticeCode.STORE_DELETED, path=str(path))


def _fresh(path: Path) -> Path:
    """Where a new database is made before it takes its place; without what an earlier attempt left."""
    new = path.with_name(path.name + ".new")
    for ending in ("", "-journal"):
        new.with_name(new.name + ending).unlink(missing_ok=True)
    return new


def _copy(source: Path, target: sqlite3.Connection) -> tuple[Counter[str], int]:
    """How many rows of each table were read, and how many were found but are not values.

    Of a table that cannot be read whole, the rows are also looked for in each page by itself.
    """
    counts, lost, torn, cut = Counter[str](), 0, set[str](), rows_cut_off(source)
    spoilt_runs = list[RawRow]()
    with closing(sqlite3.connect(source, timeout=10.0)) as connection:
        connection.text_factory = any_text
        connection.execute(
            "PRAGMA writable_schema = ON"
        )  # else it reads nothing of a file that is shorter than it says
        for table in checked_columns():
            names = [str(name) for _, name, *_ in target.execute(f"PRAGMA table_info({table})")]
            insert = _insert(table, len(names))
            for row in _all_that_can_be_read(connection, table, names, torn):
                if not is_whole(table, row) or (row[0], (None, *row[1:])) in cut:
                    lost += 1
                    torn.add(table)  # a page of another table may stand where this one begins
                    spoilt_runs += [row] * (table == "boot")
                    continue
                with suppress(sqlite3.IntegrityError):
                    counts[table] += target.execute(insert, row).rowcount
    if torn:
        columns = {table: kinds for table, kinds in checked_columns().items() if table in torn}
        for number, values in rows_in_pages(
            source, lambda some: any(_is_of(some, kinds) for kinds in columns.values())
        ):
            fitting = [table for table, kinds in columns.items() if _is_of(values, kinds)]
            whole = [(table, row) for table in fitting if is_whole(table, row := (number, *values[1:]))]
            if len(whole) == 1 and (number, values) not in cut:
                ((table, row),) = whole
                with suppress(sqlite3.IntegrityError):
                    counts[table] += target.execute(_insert(table, len(row)), row).rowcount
    counts["boot"] += _runs_of_copies(spoilt_runs, target)
    return counts, lost


def _runs_of_copies(spoilt: Sequence[RawRow], target: sqlite3.Connection) -> int:
    """Insert the rows of these runs with the other copy of the configuration; returns how many had one."""
    many = 0
    of_start = "SELECT config FROM running WHERE boot = ? AND fingerprint = ?"
    for *beginning, _, fingerprint, versions in spoilt:
        with suppress(*UNREADABLE, UnicodeEncodeError):
            for (config,) in target.execute(of_start, (beginning[0], fingerprint)).fetchall():
                run = (*beginning, config, fingerprint, versions)
                if is_whole("boot", run):
                    many += target.execute(_insert("boot", len(run)), run).rowcount
    return many


def _reference_beside(target: sqlite3.Connection, learnt: Learnt) -> tuple[RawRow | None, bool]:
    """The reference that was learnt, if the one that was read is another and not a newer one or none was; and whether
    it is known which counts."""
    if learnt.reference is None:
        return None, False
    found = target.execute(rows.REFERENCE).fetchone()
    number, why, *rest = rows.of_reference(learnt.reference)
    if found is None:
        return (number, why, *rest), True
    ended, asked_for = datetime.fromisoformat(found[4]), found[2] == Why.REFERENCE
    if ended < learnt.reference.ended:
        return (number, Why.REFERENCE.value, *rest), True  # counts before all that are older
    if ended > learnt.reference.ended and found[0] > 1 and not asked_for:  # the first of those that were read
        return (number, why, *rest), True
    return None, asked_for or ended == learnt.reference.ended


def _without_gap(target: sqlite3.Connection) -> bool:
    """Whether no measurement before the last one is missing."""
    first, last, cycles = target.execute("SELECT min(id), max(id), count(*) FROM measurement").fetchone()
    measured = target.execute("SELECT count(*) FROM frame WHERE errors IS NOT NULL").fetchone()[0]
    return bool(first == 1 and last == cycles if cycles else not measured)


def _is_of(values: Sequence[Any], kinds: Sequence[tuple[tuple[type, ...], bool]]) -> bool:
    """Whether these can be the values of a row whose number stands in its first column."""
    if len(values) != len(kinds) or values[0] is not None or kinds[0][0] != (int,):
        return False
    rest = zip(values[1:], kinds[1:], strict=True)
    return all(isinstance(value, kind) or (value is None and not required) for value, (kind, required) in rest)


def _restore(target: sqlite3.Connection, known: Known) -> None:
    if known.boot is not None:
        target.execute(_insert("boot", len(known.boot)), known.boot)
        if known.first_k is not None:
            target.execute("DELETE FROM frame WHERE k >= ? AND boot <> ?", (known.first_k, known.boot[1]))
    for given in known.standing.values():
        if not target.execute(f"{_SAME_COMMAND} LIMIT 1", given[:3]).fetchone():
            target.execute("INSERT INTO command VALUES (NULL, ?, ?, ?, ?, ?)", given)
    if known.reference is None:
        return
    number, why, asked, *_ = known.reference
    same = "SELECT count(*) FROM measurement WHERE number = ? AND why = ? AND asked = ?"
    if not target.execute(same, (number, why, asked)).fetchone()[0]:
        (first, last) = target.execute("SELECT coalesce(min(id), 1), coalesce(max(id), 0) FROM measurement").fetchone()
        place = last + 1 if why == Why.REFERENCE else first - 1  # one that was asked for is the latest of its kind
        target.execute(_insert("measurement", 1 + len(known.reference)), (place, *known.reference))


def _insert(table: str, columns: int) -> str:
    return f"INSERT OR IGNORE INTO {table} VALUES ({', '.join('?' * columns)})"


def _settle(target: sqlite3.Connection, counts: Counter[str], *, reference_known: bool) -> bool:
    """Remove what contradicts the lost rows; returns whether learning begins again."""
    _number_runs(target)
    for boot, text in target.execute("SELECT id, config FROM boot").fetchall():
        if (inputs := inputs_of_run(text)) is not None:
            target.execute("DELETE FROM frame WHERE boot = ? AND length(inputs) <> ?", (boot, 8 * inputs))
    if counts["boot"]:  # without its configuration nothing says what the inputs of a frame are
        target.execute("DELETE FROM frame WHERE boot NOT IN (SELECT id FROM boot)")
    target.execute("DELETE FROM frame WHERE k NOT IN (SELECT k FROM decision)")
    target.execute("DELETE FROM decision WHERE k NOT IN (SELECT k FROM frame)")
    if not counts["request"]:
        (last,) = target.execute("SELECT max(number) FROM measurement").fetchone()
        if last is not None:
            target.execute("INSERT INTO request VALUES (?, '')", (last + _NUMBERS_SKIPPED,))
    (boots,) = target.execute("SELECT count(*) FROM boot").fetchone()
    if boots and (reference_known or _without_gap(target)):
        return False
    # All others count from the reference: with another one they would mean something else.
    _forget(target, counts)
    return True


def _knows_more(learnt: Learnt, target: sqlite3.Connection) -> bool:
    """Whether the record that is left lacks measurements that were learnt from."""
    found = "SELECT count(*) FROM frame WHERE errors IS NOT NULL AND k <= ?"
    (measured,) = target.execute(found, (learnt.last_k,)).fetchone()
    (stood_for,) = target.execute("SELECT coalesce(max(slot), 0) FROM learnt").fetchone()
    course = learnt.state.course
    lacks = measured == 0 or (course is not None and measured < max(course.learner.mixture.count))
    return bool(lacks and learnt.last_k >= stood_for - 1)


def _forget(target: sqlite3.Connection, counts: Counter[str]) -> None:
    """Remove the record."""
    for table in (*_LEARNT, *_ALSO_LEARNT):
        target.execute(f"DELETE FROM {table}")
        counts[table] = 0
    for table in ("snapshot", "running"):
        target.execute(f"DELETE FROM {table}")
    target.execute("DELETE FROM prior_of_boot")
    target.execute("DELETE FROM boot")


def _number_runs(target: sqlite3.Connection) -> None:
    """Give each run whose number is beyond the valid range the lowest free one: where one bit has flipped, its own."""
    numbers = {number for (number,) in target.execute("SELECT number FROM boot")}
    for wrong in sorted(number for number in numbers if not 0 < number < MOST_BOOTS):
        free = next(number for number in count(1) if number not in numbers)
        target.execute("UPDATE boot SET number = ? WHERE number = ?", (free, wrong))
        numbers.add(free)


def _recounted(target: sqlite3.Connection, counts: Counter[str]) -> int:
    """Take from the counts what was read and is not kept; returns the number of these rows."""
    removed = 0
    for table in _LEARNT:
        (kept,) = target.execute(f"SELECT count(*) FROM {table}").fetchone()
        removed += max(counts[table] - kept, 0)
        counts[table] = min(counts[table], kept)
    return removed


def _all_that_can_be_read(
    source: sqlite3.Connection, table: str, names: Sequence[str], torn: set[str]
) -> Iterator[RawRow]:
    """Rows in the order of their numbers; after a damaged page it continues with the next readable one.

    torn: gets the table's name if it cannot be read to its end
    """
    if table == "prior":  # has no row numbers
        with suppress(*UNREADABLE):
            yield from source.execute(f"SELECT {', '.join(names)} FROM {table}")
            return
        with suppress(*UNREADABLE):  # once more, as below; rows that are there already are ignored
            yield from source.execute(f"SELECT {', '.join(names)} FROM {table}")
        return
    query = f"SELECT rowid, {', '.join(names)} FROM {table} WHERE rowid > ? ORDER BY rowid"
    low: int | None = -_FARTHEST
    failed_at: int | None = None
    while low is not None:
        try:
            for number, *row in source.execute(query, (low,)):
                low = max(low, number)
                yield tuple(row)
            return
        except UNREADABLE:
            torn.add(table)
            if failed_at == low:
                low = _behind(lambda at: source.execute(query + " LIMIT 1", (at,)).fetchone(), low)
            else:  # once more: a disk that failed once has not damaged a page
                failed_at = low


def _behind(first_after: Callable[[int], RawRow | None], low: int) -> int | None:
    """The smallest number above `low` behind which a row can be read; None: no row can."""
    low, gap = max(low, 0), 1
    while gap < _FARTHEST:
        with suppress(*UNREADABLE):
            if first_after(low + gap) is None:
                return None if gap == 1 else _between(first_after, low + gap // 2, low + gap)
            return _between(first_after, low + gap // 2, low + gap)
        gap *= 2
    return None


def _between(first_after: Callable[[int], RawRow | None], bad: int, good: int) -> int:
    """By bisection: the first number from which on reading works."""
    while good - bad > 1:
        middle = (bad + good) // 2
        try:
            first_after(middle)
        except UNREADABLE:
            bad = middle
        else:
            good = middle
    return good
