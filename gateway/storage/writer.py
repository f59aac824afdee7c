"""The thread that writes to the database: statements in order, committed in groups, and tried again while that fails.

A full disk, a locked file or an error of the disk does not end the gateway. The rows wait in memory
(gateway.storage.waiting says which of them for how long), and the thread opens the file again every few
seconds until they are stored.
"""

import logging
import math
import shutil
import sqlite3
import threading
import time
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path

from gateway.model.codes import NoticeCode
from gateway.model.events import StoreHealth
from gateway.model.text import NOTHING, Text, failure, text_of
from gateway.storage.damage import contradiction
from gateway.storage.faults import DamagedError, GoneError, StoreError
from gateway.storage.place import PlaceWatch, check_log
from gateway.storage.schema import connect, is_damage
from gateway.storage.snapshot import Snapshot, put_snapshots
from gateway.storage.timing import WriterTiming
from gateway.storage.waiting import Item, Rows, Waiting, WaitingKind, tables_of

log = logging.getLogger(__name__)

_HANGS = Text(NoticeCode.DISK_HANGS)
_REPAIRS = "a damaged database is being repaired"
_STEPS_A_LOOK = 10_000
"""Steps of SQLite's machine: about a millisecond of a statement that takes long."""
_YIELD_S = 0.05
"""How long a producer that is faster than the thread waits for it, as in a simulation that outruns the disk."""
_GATHER_S = 0.2
"""How long readings wait for each other, real seconds, so that the thread wakes up for all at once."""
_MOST_GATHERED = 1000
"""How many of them wait."""
_REFUSED = (sqlite3.IntegrityError, sqlite3.DataError, sqlite3.InterfaceError, sqlite3.ProgrammingError, OverflowError)
"""What the database raises for rows that it would never accept: the gateway's own mistake."""


class DatabaseWriter:
    """Executes statements on its own connection.

    Parameters
    ----------
    path: the database; its tables exist
    prune: deletes what is too old; called in the thread, when it opens the file and each `prune_s`
    end: called in the thread before the last commit
    mend: sets a damaged file aside for a reason, begins another, and says so; called in the thread, which then has no
        connection
    mended: what became of a file that was damaged before
    kept: called in the thread with each snapshot that was put into the database
    """

    def __init__(
        self,
        path: Path,
        timing: WriterTiming,
        prune: Callable[[sqlite3.Connection], None],
        end: Callable[[sqlite3.Connection], None],
        mend: Callable[[str], Text],
        mended: Text = NOTHING,
        kept: Callable[[Snapshot], None] = lambda _: None,
    ) -> None:
        self._kept_one = kept
        self._abandoned = False
        """The end did not wait any longer for the disk; the thread may still be in a call."""
        self._asked_s: float | None = None
        """Since when the disk has been at work; None: it has nothing to do."""
        self._path, self._timing, self._prune, self._end = path, timing, prune, end
        self._mend, self._mended, self._to_mend = mend, mended, ""
        self._mending, self._times_mended = threading.Lock(), 0
        self._changed = threading.Condition()
        self._waiting = Waiting()
        self._gather_s = min(_GATHER_S, timing.commit_s / 5)
        self._every_s = timing.commit_s - 2 * self._gather_s
        """From the first row to its commit; readings may wait for others before and after it; `commit_s` in all."""
        self._gathered = False
        """Whether anything waits that does not wait for more readings."""
        self._open: list[Item] = []
        """Executed and not committed."""
        self._last = 0
        self._closing_s: float | None = None
        self._ended = self._pruning = False
        self._problem, self._failing_since = NOTHING, 0.0
        self._refused, self._refusal = 0, NOTHING
        self._kept = False
        """Whether a connection stays open between two attempts."""
        self._committed_s = 0.0
        self._free_mb: float | None = None
        self._looked_s = 0.0
        self._thread = threading.Thread(target=self._run, name=f"store {path.name}", daemon=True)

    @property
    def health(self) -> StoreHealth:
        """The state of storing; may be called from another thread."""
        with self._changed:
            now, asked_s = time.monotonic(), self._asked_s
            hanging_s = 0.0 if asked_s is None or now - asked_s < self._timing.hangs_after_s else now - asked_s
            return StoreHealth(
                problem=self._problem or (_HANGS if hanging_s else self._refusal),
                failing_s=now - self._failing_since if self._problem else hanging_s,
                waiting=self._waiting.rows,
                dropped=sum(self._waiting.dropped.values()),
                free_mb=self._free_mb,
                mended=self._mended,
                oldest_s=None if (since_s := self._waiting.since_s) is None else now - since_s,
            )

    def start(self) -> None:
        """Start the thread; statements may already be waiting."""
        self._look()
        self._thread.start()

    def close(self) -> bool:
        """Return when everything is committed, a last attempt has failed, or the disk has been silent for `silent_s`.

        The silence also counts that began before the call. Returns False if the thread is still waiting for the disk.
        """
        with self._changed:
            began_s = self._closing_s = time.monotonic()
            self._changed.notify_all()
            while not self._ended:
                since_s = began_s if self._asked_s is None else self._asked_s
                left_s = since_s + self._timing.silent_s - time.monotonic()
                if left_s <= 0.0:
                    self._abandoned = True
                    self._changed.notify_all()
                    return False
                self._changed.wait(left_s)
        self._thread.join()
        return True

    def check(self) -> None:
        """Call after `close`. Raises StoreError if rows were not stored."""
        with self._changed:
            lost = tables_of([*self._waiting, *self._open])
            dropped = sum(self._waiting.dropped.values())
        count = lost.total() + dropped + self._refused
        which = ", ".join(f"{table} {rows}" for table, rows in lost.items())
        if self._abandoned:
            what = _REPAIRS if self._mending.locked() else _HANGS
            silent = (
                f"{self._path}: {what}; the gateway was stopped without waiting longer than {self._timing.silent_s:g} s"
            )
            if count:
                raise StoreError(f"{silent}; {count} rows may be lost ({which})")
            log.warning("%s; everything is stored", silent)
        elif count:
            why = self._problem or self._refusal or "they waited too long"
            raise StoreError(f"{self._path}: {count} rows were not stored: {why}" + (f" ({which})" if which else ""))

    def put(
        self,
        table: str,
        statement: str,
        rows: Rows,
        *,
        kind: WaitingKind = WaitingKind.KEPT,
        commit: bool = False,
    ) -> None:
        """Execute the statement, which changes this table, for each row; never raises.

        commit: at once, as soon as nothing else waits
        """
        with self._changed:
            works = self._asked_s is None or time.monotonic() - self._committed_s < WriterTiming.look_s
            if self._waiting.full(kind) and not self._problem and works:
                self._changed.wait_for(lambda: not self._waiting.full(kind) or self._problem, _YIELD_S)
            self._last += 1
            self._waiting.put(Item(self._last, table, statement, rows, kind, commit, time.monotonic()))
            if kind is not WaitingKind.READINGS or commit or self._waiting.rows >= _MOST_GATHERED:
                self._gathered = True
            if self._gathered or len(self._waiting) == 1:
                self._changed.notify_all()

    def flush(self, kinds: Collection[WaitingKind] = tuple(WaitingKind), limit_s: float | None = None) -> None:
        """Return when all of some kinds put so far are committed. Raises StoreError when that fails or takes longer."""
        self.put("", "", (), commit=True)
        with self._changed:
            number = self._last
            self._changed.wait_for(lambda: self._oldest(kinds) > number or self._problem or self._over, limit_s)
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
                self._changed.wait_for(lambda: not self._to_mend or self._over)
            if self._times_mended == times_mended:
                raise StoreError(f"{self._path}: {self._problem}")

    def _oldest(self, kinds: Collection[WaitingKind]) -> float:
        """The smallest number of the uncommitted items."""
        executed = (item.number for item in self._open if item.kind in kinds)
        return min(self._waiting.oldest(kinds), min(executed, default=math.inf))

    @property
    def _closing(self) -> bool:
        return self._closing_s is not None

    @property
    def _over(self) -> bool:
        """Nobody waits for the thread any more."""
        return self._ended or self._abandoned

    @property
    def _is_called(self) -> bool:
        return self._gathered or self._closing or bool(self._to_mend)

    # In the thread ---------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            self._attempt()
        finally:
            with self._changed:
                self._ended = True
                self._changed.notify_all()

    def _attempt(self) -> None:
        """Write until it is closed, again after every failure.

        A commit whose synchronisation fails is rolled back, but is in the log. Whoever opens the database first, when
        nobody else has it open, reads all of the log, and the rows would be there twice after the next attempt. So one
        more connection stays open from one attempt to the next.
        """
        with ExitStack() as kept_open:
            while self._attempted(kept_open):
                pass

    def _attempted(self, kept_open: ExitStack) -> bool:
        """One attempt; whether there is to be another one."""
        last = self._closing
        self._asked_s = time.monotonic()
        try:
            with closing(connect(self._path, self._timing.retry_s)) as connection:
                connection.set_progress_handler(self._goes_on, _STEPS_A_LOOK)
                if not self._kept:
                    self._keep_open(kept_open)
                self._write_to(connection)
            return False
        except Exception as raised:  # noqa: BLE001 - the gateway continues without its store
            error = self._cause(raised)
            self._failed(error)
            if is_damage(error) or isinstance(error, GoneError) or self._to_mend:
                kept_open.close()
                self._kept = False
                self._renew(self._to_mend or text_of(error))
                return True
        if last:
            return False
        with self._changed:
            self._changed.wait_for(lambda: self._closing, self._timing.retry_s)
        self._look()
        return True

    def _cause(self, error: Exception) -> Exception:
        """SQLite cannot tell a log that was cut from a disk that fails."""
        try:
            check_log(self._path)
        except DamagedError as cut:
            return cut
        return error

    def _keep_open(self, kept_open: ExitStack) -> None:
        with ExitStack() as opened:
            connection = opened.enter_context(closing(connect(self._path, self._timing.retry_s)))
            connection.execute("SELECT count(*) FROM sqlite_master").fetchone()  # opens the log
            kept_open.push(opened.pop_all())
        self._kept = True

    def _renew(self, why: str) -> None:
        try:
            with self._mending:
                mended = self._mend(why)
                self._times_mended += 1
        except Exception as error:  # noqa: BLE001 - tried again as any failure
            self._failed(error)
            with self._changed:
                self._to_mend = ""
                self._changed.wait_for(lambda: self._closing, self._timing.retry_s)
            return
        with self._changed:
            self._mended, self._to_mend = mended, ""
            self._changed.notify_all()

    def _failed(self, error: Exception) -> None:
        with self._changed:
            self._asked_s = None
            self._waiting.put_back(self._open)
            self._open.clear()
            first, self._problem = not self._problem, failure(error)
            if first:
                self._failing_since = time.monotonic()
            self._changed.notify_all()
        if first:
            expected = isinstance(error, sqlite3.Error | OSError | StoreError)
            log.log(logging.INFO if expected else logging.ERROR, "%s: %s", self._path, error, exc_info=not expected)

    def _write_to(self, connection: sqlite3.Connection) -> None:
        """Until the writer is closed and nothing waits any more. Raises the database's errors."""
        place = PlaceWatch(self._path)
        self._delete_old(connection)
        pruned = time.monotonic()
        due, wanted = pruned + self._every_s, False
        while True:
            item = self._next(min(due, pruned + self._timing.prune_s, self._looked_s + self._timing.look_s))
            if item is None and self._closing and not len(self._waiting):
                self._commit(connection)
                self._end(connection)
                self._commit(connection)
                self._goes_on()
                return
            if item is not None and item.statement:
                self._execute(connection, item)
            now = time.monotonic()
            if self._open or self._problem:
                due = min(due, now + self._every_s)
            if now - pruned >= self._timing.prune_s:
                self._delete_old(connection)
                pruned = now
            wanted = wanted or (item is not None and item.commit)
            if (wanted and not self._gathered) or now >= due:
                place.look()  # a commit may begin a checkpoint
                self._commit(connection)
                due, wanted = math.inf, False
            if now - self._looked_s >= self._timing.look_s:
                self._look()
                place.look()

    def _delete_old(self, connection: sqlite3.Connection) -> None:
        """In its own transaction. If the gateway is stopped meanwhile and this takes long, it is left for another
        time."""
        if self._open:  # an empty commit succeeds on a disk that fails, and would end the problem
            self._commit(connection)
        self._pruning = True
        try:
            self._prune(connection)
        except sqlite3.OperationalError as error:
            if getattr(error, "sqlite_errorcode", None) != sqlite3.SQLITE_INTERRUPT:
                raise
            connection.rollback()
        finally:
            self._pruning = False
        self._commit(connection)

    def _goes_on(self) -> bool:
        """A statement makes progress; called by SQLite. Whether it is interrupted."""
        now = self._asked_s = time.monotonic()
        return self._pruning and self._closing_s is not None and now - self._closing_s > self._timing.silent_s

    def _next(self, until_s: float) -> Item | None:
        """What is to be executed next; None: nothing came until then, or the writer is closed."""
        with self._changed:
            self._asked_s = None
            if self._changed.wait_for(lambda: self._is_called or len(self._waiting), until_s - time.monotonic()):
                self._changed.wait_for(lambda: self._is_called, self._gather_s)
            self._asked_s = time.monotonic()
            if self._to_mend:
                raise StoreError(self._to_mend)
            item = self._waiting.take()
            self._gathered = len(self._waiting) > 0
            if item is not None:
                self._open.append(item)
            return item

    def _execute(self, connection: sqlite3.Connection, item: Item) -> None:
        try:
            if item.kind is WaitingKind.SNAPSHOTS:
                put_snapshots(connection, item.statement, item.rows)
                for *_, snapshot in item.rows:
                    if isinstance(snapshot, Snapshot):
                        self._kept_one(snapshot)
            else:
                connection.executemany(item.statement, item.rows)
        except _REFUSED as error:
            refusal = Text(NoticeCode.ROWS_REFUSED, table=item.table, error=str(error))
            if not self._refused:
                # Pages that contradict each other may refuse any row.
                if found := contradiction(connection):
                    raise DamagedError(found) from error
                log.exception("%s: %s; please report this", self._path, refusal)
            with self._changed:
                self._refused += len(item.rows)
                self._refusal = refusal

    def _commit(self, connection: sqlite3.Connection) -> None:
        connection.commit()
        with self._changed:
            works = bool(self._open) or not len(self._waiting)  # an empty commit succeeds even on a full disk
            self._open.clear()
            self._committed_s = time.monotonic()
            self._problem = NOTHING if works else self._problem
            self._changed.notify_all()

    def _look(self) -> None:
        self._looked_s = time.monotonic()
        try:
            self._free_mb = shutil.disk_usage(self._path.parent).free / 1e6
        except OSError:
            self._free_mb = None
