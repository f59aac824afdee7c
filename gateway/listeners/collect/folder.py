"""The folder of a site: `TABLE/machine=NAME/day=DATE/part-NUMBER.parquet`, and how far each machine is collected.

A batch of rows is written to temporary files. Replacing the machine's progress file commits it. Then its files are
moved to their places; the next start repeats missing moves. So each row is there once, whatever is killed at any
moment. A reader of the folder sees only complete files. A day's last part is replaced by a larger one until it is full.
"""

import errno
import fcntl
import logging
import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

import pyarrow as pa
from pyarrow import parquet

from gateway.listeners.collect.progress import (
    CollectProgress,
    checked_machine,
    load_progress,
    save_progress,
)
from gateway.listeners.collect.tables import by_day
from gateway.runtime.whole_file import sync_folder

log = logging.getLogger(__name__)

_PART_ROWS = 100_000
_PROGRESS = "progress"
_INCOMING = "incoming"
_PART = re.compile(r"part-(\d{5})\.parquet")


class CollectError(OSError):
    """The folder cannot be used; the message says why and what to do."""


@dataclass(frozen=True, slots=True)
class Commit:
    """What a batch adds."""

    progress: CollectProgress
    """How far the machine is collected with it."""
    rows: Mapping[str, pa.Table]
    """By table."""


class SiteFolder:
    """One site's, as a context manager; one collector writes to it at a time.

    part_rows: a part with this many rows grows no more

    Raises CollectError on entry when another collector uses it, or when it cannot be written.
    """

    def __init__(self, path: Path, *, part_rows: int = _PART_ROWS) -> None:
        self._path, self._part_rows = path, part_rows

    def __enter__(self) -> Self:
        try:
            for name in (_PROGRESS, _INCOMING):
                (self._path / name).mkdir(parents=True, exist_ok=True)
            self._lock = (self._path / _PROGRESS / "lock").open("w")
        except OSError as error:
            raise CollectError(f"{self._path}: cannot be written: {error.strerror}") from error
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            self._lock.close()
            raise CollectError(f"{self._path}: another collector writes to this folder") from None
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._lock.close()

    def ready(self) -> None:
        """The folder is there from the entry on; each machine tells what it could not write."""

    def progress(self, machine: str) -> CollectProgress:
        """How far a machine is collected, after what an interrupted batch left to do is done.

        Raises ValueError for a name that no gateway has or a damaged file, OSError.
        """
        with self._told():
            found = load_progress(self._progress_path(machine))
            self._move(found)
            for left in self._incoming(machine).glob("*"):  # of a batch that does not count
                left.unlink()
            return found

    def collected_as(self, table: str, epoch: str) -> tuple[str, CollectProgress] | None:
        """The machine of which this epoch of a table is collected, and how far. Raises OSError."""
        for path in sorted((self._path / _PROGRESS).glob("*.json")):
            with suppress(ValueError):  # a damaged one holds up its own machine, which says so
                found = load_progress(path)
                if found.last(table, epoch) is not None:
                    return path.stem, found
        return None

    def add(self, machine: str, commit: Commit) -> CollectProgress:
        """Make a batch count; when this returns its rows and the progress are on the disk.

        Raises OSError or ValueError; then ask `progress` again, which says whether it counts.
        """
        with self._told():
            return self._added(machine, commit)

    def _added(self, machine: str, commit: Commit) -> CollectProgress:
        batch, moves = commit.progress.batch + 1, list[tuple[str, str]]()
        incoming = self._incoming(machine)
        incoming.mkdir(exist_ok=True)
        for table, rows in commit.rows.items():
            for day, of_day in by_day(rows):
                for target, whole in self._parts(self._path / table / f"machine={machine}" / f"day={day}", of_day):
                    written = incoming / f"{batch}-{len(moves)}.parquet"
                    _write(written, whole)
                    moves.append((str(written.relative_to(self._path)), str(target.relative_to(self._path))))
        if moves:
            sync_folder(incoming)
        counted = CollectProgress(batch, commit.progress.places, tuple(moves))
        save_progress(self._progress_path(machine), counted)
        self._move(counted)
        return counted

    @contextmanager
    def _told(self) -> Iterator[None]:
        """Say where it happened and what to do. Raises CollectError instead of OSError."""
        try:
            yield
        except OSError as error:
            why = error.strerror or str(error)
            where = f" ({error.filename})" if error.filename else ""
            todo = "free some space" if error.errno in (errno.ENOSPC, errno.EDQUOT) else "see to its disk"
            raise CollectError(
                f"{self._path}: cannot be written or read: {why}{where}; {todo}. The gateways keep their rows meanwhile"
            ) from error

    def _progress_path(self, machine: str) -> Path:
        return self._path / _PROGRESS / f"{checked_machine(machine)}.json"

    def _incoming(self, machine: str) -> Path:
        return self._path / _INCOMING / machine

    def _move(self, progress: CollectProgress) -> None:
        touched = set()
        for written, target in progress.moves:
            source, place = self._path / written, self._path / target
            if source.exists():
                place.parent.mkdir(parents=True, exist_ok=True)
                source.replace(place)
                touched |= {place.parent, *list(place.parents)[1:3]}
        for folder in touched:
            sync_folder(folder)

    def _parts(self, folder: Path, rows: pa.Table) -> Iterator[tuple[Path, pa.Table]]:
        """Files to write: the last part with more rows in it, or another one."""
        number, last = _last_part(folder)
        if last is not None:
            whole = _with(last, rows, self._part_rows)
            if whole is not None:
                yield last, whole
                return
        yield folder / f"part-{number + 1:05d}.parquet", rows


def _last_part(folder: Path) -> tuple[int, Path | None]:
    try:
        found = [(int(match[1]), path) for path in folder.iterdir() if (match := _PART.fullmatch(path.name))]
    except FileNotFoundError:
        found = []
    return max(found, default=(0, None))


def _with(path: Path, rows: pa.Table, most: int) -> pa.Table | None:
    """The rows of a file and those behind them; None: it is large enough, or has other columns."""
    try:
        with parquet.ParquetFile(path) as file:
            if file.metadata.num_rows + rows.num_rows > most or not file.schema_arrow.equals(rows.schema):
                return None
            return pa.concat_tables([file.read(), rows])
    except (OSError, pa.ArrowException) as error:
        log.error("%s: is damaged and left as it is: %s", path, error)
        return None


def _write(path: Path, rows: pa.Table) -> None:
    with path.open("wb") as file:
        parquet.write_table(rows, file, compression="zstd")
        file.flush()
        os.fsync(file.fileno())
