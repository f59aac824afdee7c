"""The thread that writes to the database: statements in order, committed in groups."""

import queue
import sqlite3
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import closing, suppress
from pathlib import Path

from gateway.storage.schema import StoreError, connect

_PRUNE_EVERY_S = 600.0
_DRAIN_S = 0.1
_QUEUE = 20_000
"""Statements that may wait for the disk; beyond, the oldest readings would have to go, so writing waits instead."""

Rows = Sequence[Sequence[object]]


class DatabaseWriter:
    """Executes statements on a connection of its own.

    Parameters
    ----------
    path: the database; its tables exist
    commit_s: committed at least so often, real seconds
    prune: deletes what is too old; called in the thread, at its start and each ten minutes
    """

    def __init__(self, path: Path, commit_s: float, prune: Callable[[sqlite3.Connection], None]) -> None:
        self._path, self._commit_s, self._prune = path, commit_s, prune
        self._queue: queue.Queue[tuple[str, Rows, bool] | None] = queue.Queue(_QUEUE)
        self._failure: BaseException | None = None
        self._closing = False
        self._thread = threading.Thread(target=self._run, name=f"store {path.name}", daemon=True)

    def start(self) -> None:
        """Begin; statements may already wait."""
        self._thread.start()

    def close(self) -> None:
        """Return when everything is committed, or the thread has failed."""
        self._closing = True
        self._queue.put(None)
        self._thread.join()

    def check(self) -> None:
        """Raises StoreError when a statement has failed: nothing is written any more."""
        if self._failure is not None:
            raise StoreError(f"{self._path}: {self._failure}") from self._failure

    def put(self, statement: str, rows: Rows, *, commit: bool = False) -> None:
        """Execute the statement for each row; commit: at once, as soon as nothing else waits. Raises StoreError."""
        self.check()
        self._queue.put((statement, rows, commit))

    def flush(self) -> None:
        """Return when everything put so far is committed."""
        self.put("", (), commit=True)
        self._queue.join()

    def _run(self) -> None:
        try:
            with closing(connect(self._path)) as connection:
                self._write_to(connection)
        except BaseException as error:  # noqa: BLE001 - handed to the caller by the next call
            self._failure = error
            while not (self._closing and self._queue.empty()):  # no producer may wait for a writer that has ended
                with suppress(queue.Empty):
                    self._queue.get(timeout=_DRAIN_S)
                    self._queue.task_done()

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
                self._queue.task_done()  # also of a statement that failed: `flush` waits for it
