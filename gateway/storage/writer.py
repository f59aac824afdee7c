"""The thread that writes to the database: statements in order, committed in groups, and tried again while that fails.

A full disk, a locked file or an error of the disk does not end the gateway. The rows wait in memory
(gateway.storage.waiting says which of them for how long), and the thread opens the file again every few
seconds until they are stored.
"""

import logging
import math
import os
import shutil
import sqlite3
import threading
import time
from collections.abc import Callable, Collection, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from gateway.events import StoreHealth
from gateway.storage.damage import contradiction
from gateway.storage.faults import DamagedError, GoneError, StoreError
from gateway.storage.schema import connect, is_damage
from gateway.storage.waiting import Item, Kind, Rows, Waiting

log = logging.getLogger(__name__)

_PRUNE_EVERY_S = 600.0
_LOOK_EVERY_S = 10.0
"""Real seconds."""
_YIELD_S = 0.05
"""How long a producer that is faster than the thread waits for it, as in a simulation that outruns the disk."""
_REFUSED = (sqlite3.IntegrityError, sqlite3.DataError, sqlite3.InterfaceError, sqlite3.ProgrammingError, OverflowError)
"""What the database raises for rows that it would never accept: the gateway's own mistake."""


class DatabaseWriter:
    """Executes statements on its own connection.

    Parameters
    ----------
    path: the database; its tables exist
    commit_s: commits at least this often, in real seconds
    prune: deletes what is too old; called in the thread, when it opens the file and each ten minutes
    end: called in the thread before the last commit
    mend: sets a damaged file aside for a reason, begins another, and says so; called in the thread, which then has no
        connection
    retry_s: how long another program's lock is waited for, and how long between two attempts, real seconds
    mended: what became of a file that was damaged before
    look_s: how often the disk's free space is read, and whether the file is still at its path
    """

    def __init__(
        self,
        path: Path,
        commit_s: float,
        prune: Callable[[sqlite3.Connection], None],
        end: Callable[[sqlite3.Connection], None],
        mend: Callable[[str], str],
        retry_s: float = 5.0,
        mended: str = "",
        look_s: float = _LOOK_EVERY_S,
    ) -> None:
        self._look_s = look_s
        self._path, self._commit_s, self._prune, self._end, self._retry_s = path, commit_s, prune, end, retry_s
        self._mend, self._mended, self._to_mend = mend, mended, ""
        self._mending, self._times_mended = threading.Lock(), 0
        self._changed = threading.Condition()
        self._waiting = Waiting()
        self._open: list[Item] = []
        """Executed and not committed."""
        self._last = 0
        self._closing = self._ended = False
        self._problem, self._failing_since = "", 0.0
        self._refused, self._refusal = 0, ""
        self._committed_s = 0.0
        self._free_mb: float | None = None
        self._looked_s = 0.0
        self._thread = threading.Thread(target=self._run, name=f"store {path.name}", daemon=True)

    @property
    def health(self) -> StoreHealth:
        """The state of storing; may be called from another thread."""
        with self._changed:
            return StoreHealth(
                problem=self._problem or self._refusal,
                failing_s=time.monotonic() - self._failing_since if self._problem else 0.0,
                waiting=self._waiting.rows,
                dropped=sum(self._waiting.dropped.values()),
                free_mb=self._free_mb,
                mended=self._mended,
            )

    def start(self) -> None:
        """Start the thread; statements may already be waiting."""
        self._look()
        self._thread.start()

    def close(self) -> None:
        """Return when everything is committed, or a last attempt has failed."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        self._thread.join()

    def check(self) -> None:
        """Call after `close`. Raises StoreError if rows were not stored."""
        lost, dropped = self._waiting.rows, sum(self._waiting.dropped.values())
        if lost or dropped or self._refused:
            raise StoreError(
                f"{self._path}: {lost + dropped + self._refused} rows were not stored: "
                f"{self._problem or self._refusal or 'they waited too long'}"
            )

    def put(self, statement: str, rows: Rows, *, kind: Kind = Kind.KEPT, commit: bool = False) -> None:
        """Execute the statement for each row; commit: at once, as soon as nothing else waits. Never raises."""
        with self._changed:
            if self._waiting.full(kind) and not self._problem and self._makes_progress():
                self._changed.wait_for(lambda: not self._waiting.full(kind) or self._problem, _YIELD_S)
            self._last += 1
            self._waiting.put(Item(self._last, statement, rows, kind, commit))
            self._changed.notify_all()

    def flush(self, kinds: Collection[Kind] = tuple(Kind), limit_s: float | None = None) -> None:
        """Return when all of some kinds put so far are committed. Raises StoreError when that fails or takes longer."""
        self.put("", (), commit=True)
        with self._changed:
            number = self._last
            self._changed.wait_for(lambda: self._oldest(kinds) > number or self._problem or self._ended, limit_s)
            if self._oldest(kinds) <= number:
                raise StoreError(f"{self._path}: {self._problem or f'nothing was stored within {limit_s} s'}")

    @contextmanager
    def same_file(self) -> Iterator[int]:
        """Inside, the file is not set aside; gives how often it has been."""
        with self._mending:
            yield self._times_mended

    def mend(self, why: str, times_mended: int) -> None:
        """Return when the file that had been mended so often is set aside and another one begun. Raises StoreError."""
        with self._changed:
            if self._times_mended == times_mended:
                self._to_mend = why
                self._changed.notify_all()
                self._changed.wait_for(lambda: not self._to_mend or self._ended)
            if self._times_mended == times_mended:
                raise StoreError(f"{self._path}: {self._problem}")

    def _oldest(self, kinds: Collection[Kind]) -> float:
        """The smallest number of the uncommitted items."""
        executed = (item.number for item in self._open if item.kind in kinds)
        return min(self._waiting.oldest(kinds), min(executed, default=math.inf))

    def _makes_progress(self) -> bool:
        return time.monotonic() - self._committed_s < _LOOK_EVERY_S

    # In the thread ---------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            self._attempt()
        finally:
            with self._changed:
                self._ended = True
                self._changed.notify_all()

    def _attempt(self) -> None:
        """Write until it is closed, again after every failure."""
        while True:
            last = self._closing
            try:
                with closing(connect(self._path, self._retry_s)) as connection:
                    self._write_to(connection)
                return
            except Exception as error:  # noqa: BLE001 - the gateway continues without its store
                self._failed(error)
                if is_damage(error) or isinstance(error, GoneError) or self._to_mend:
                    self._renew(self._to_mend or str(error))
                    continue
            if last:
                return
            with self._changed:
                self._changed.wait_for(lambda: self._closing, self._retry_s)
            self._look()

    def _renew(self, why: str) -> None:
        try:
            with self._mending:
                mended = self._mend(why)
                self._times_mended += 1
        except Exception as error:  # noqa: BLE001 - tried again as any failure
            self._failed(error)
            with self._changed:
                self._to_mend = ""
                self._changed.wait_for(lambda: self._closing, self._retry_s)
            return
        with self._changed:
            self._mended, self._to_mend = mended, ""
            self._changed.notify_all()

    def _failed(self, error: Exception) -> None:
        with self._changed:
            self._waiting.put_back(self._open)
            self._open.clear()
            first, self._problem = not self._problem, str(error)
            if first:
                self._failing_since = time.monotonic()
            self._changed.notify_all()
        if first:
            expected = isinstance(error, sqlite3.Error | OSError | StoreError)
            log.log(logging.INFO if expected else logging.ERROR, "%s: %s", self._path, error, exc_info=not expected)

    def _write_to(self, connection: sqlite3.Connection) -> None:
        """Until the writer is closed and nothing waits any more. Raises the database's errors."""
        opened = self._path.stat()
        self._prune(connection)
        self._commit(connection)
        committed = pruned = time.monotonic()
        wanted = False
        while True:
            item = self._next()
            if item is None:
                self._commit(connection)
                if self._closing and not len(self._waiting):
                    self._end(connection)
                    self._commit(connection)
                    return
            elif item.statement:
                self._execute(connection, item)
            now = time.monotonic()
            if now - pruned >= _PRUNE_EVERY_S:
                self._prune(connection)
                pruned = now
            wanted = wanted or (item is not None and item.commit)
            if (wanted and not len(self._waiting)) or now - committed >= self._commit_s:
                self._commit(connection)
                committed, wanted = now, False
            if now - self._looked_s >= self._look_s:
                self._look()
                self._check_place(opened)

    def _check_place(self, opened: os.stat_result) -> None:
        """A file that is deleted stays open, and whatever is written to it is lost in the end."""
        try:
            if os.path.samestat(opened, self._path.stat()):
                return
        except FileNotFoundError:
            raise GoneError("the database was deleted while the gateway ran") from None
        raise GoneError("another file was put in its place while the gateway ran")

    def _next(self) -> Item | None:
        with self._changed:
            self._changed.wait_for(lambda: len(self._waiting) or self._closing or self._to_mend, self._commit_s)
            if self._to_mend:
                raise StoreError(self._to_mend)
            item = self._waiting.take()
            if item is not None:
                self._open.append(item)
            return item

    def _execute(self, connection: sqlite3.Connection, item: Item) -> None:
        try:
            connection.executemany(item.statement, item.rows)
        except _REFUSED as error:
            if not self._refused:
                # Pages that contradict each other may refuse any row.
                if found := contradiction(connection):
                    raise DamagedError(found) from error
                log.exception("%s: refuses %s", self._path, item.statement)
            with self._changed:
                self._refused += len(item.rows)
                self._refusal = f"the database refuses rows: {error}"

    def _commit(self, connection: sqlite3.Connection) -> None:
        connection.commit()
        with self._changed:
            works = self._open or not len(self._waiting)  # or the disk may be full for anything but nothing
            self._open.clear()
            self._committed_s = time.monotonic()
            self._problem = "" if works else self._problem
            self._changed.notify_all()

    def _look(self) -> None:
        self._looked_s = time.monotonic()
        try:
            self._free_mb = shutil.disk_usage(self._path.parent).free / 1e6
        except OSError:
            self._free_mb = None
