"""Work on a disk that may not answer, in a separate thread: callers wait for a limited time, and the process can end.

A call to a disk that hangs (a card that is failing, an adapter that lost its power, a network that is gone) returns
when the disk does, or never, and nothing can interrupt it.
"""

import asyncio
import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import Any, Generic, TypeVar

from gateway.model.codes import NoticeCode
from gateway.model.text import Text
from gateway.storage.faults import StoreError

OnDisk = TypeVar("OnDisk")
ANSWERS_WITHIN_S = 20.0
"""Real seconds. SQLite waits 10 s for another program's lock, and says so itself."""
_STOPS_WITHIN_S = 1.0
"""How long work that is nearly done may hold up an end."""


class DiskWork(Generic[OnDisk]):
    """Something that a thread finds on a disk; begins at once.

    Parameters
    ----------
    path: what is opened, for messages
    work: runs in the thread; what it raises is raised by `wait` and `until`
    limit_s: how long it may take besides its `long_work`, real s
    unwanted: called in the thread with what it found when nobody waits for it any more
    """

    def __init__(
        self,
        path: Path,
        work: Callable[[], OnDisk],
        limit_s: float = ANSWERS_WITHIN_S,
        unwanted: Callable[[OnDisk], None] = lambda _: None,
    ) -> None:
        self._path, self._work, self._limit_s, self._unwanted = path, work, limit_s, unwanted
        self._changed = threading.Condition()
        self._since_s: float | None = time.monotonic()
        self._found: list[OnDisk] = []
        self._error: BaseException | None = None
        self._ended = self._abandoned = False
        self._tell: Callable[[], object] = lambda: None
        threading.Thread(target=self._run, name=f"opening {path.name}", daemon=True).start()

    def wait(self) -> OnDisk:
        """What it found. Raises StoreError when the disk does not answer in time."""
        with self._changed:
            while not self._ended:
                left_s = self._left_s()
                if left_s <= 0.0:
                    break
                self._changed.wait(None if math.isinf(left_s) else left_s)
            ended = self._ended
        if ended:
            return self._outcome()
        self._leave()
        raise self._silent()

    async def until(self, stop: asyncio.Event) -> OnDisk | None:
        """What it found; None: stopped before that. Raises StoreError as `wait`.

        A stop, and cancelling it, still wait a second for what is nearly done.
        """
        told = asyncio.Event()
        self._notify_loop(asyncio.get_running_loop(), told)
        stopping, silent = asyncio.create_task(_passed_on(stop, told)), False
        try:
            while not (self._over() or stop.is_set() or silent):
                told.clear()
                if not self._over():
                    await _within(self._left_s(), told)
                silent = self._left_s() <= 0.0 and not stop.is_set()
            await self._last_chance(0.0 if silent else _STOPS_WITHIN_S, told)
        except asyncio.CancelledError:
            await self._last_chance(_STOPS_WITHIN_S, told)
            self._leave()
            raise
        finally:
            stopping.cancel()
        if self._over():
            return self._outcome()
        self._leave()
        if silent:
            raise self._silent()
        return None

    def _over(self) -> bool:
        return self._ended

    async def _last_chance(self, limit_s: float, told: asyncio.Event) -> None:
        end_s = time.monotonic() + limit_s
        while not self._ended and (left_s := end_s - time.monotonic()) > 0.0:
            told.clear()
            await _within(left_s, told)

    def _leave(self) -> None:
        """Nobody waits any more: drop the result, now or when it comes."""
        with self._changed:
            self._abandoned = True
            found = self._found if self._ended else []
        for each in found:
            self._unwanted(each)

    def _notify_loop(self, loop: asyncio.AbstractEventLoop, told: asyncio.Event) -> None:
        def tell() -> None:
            with suppress(RuntimeError):  # the loop is closed
                loop.call_soon_threadsafe(told.set)

        with self._changed:
            self._tell = tell

    def _left_s(self) -> float:
        return float("inf") if self._since_s is None else self._since_s + self._limit_s - time.monotonic()

    def _silent(self) -> StoreError:
        return StoreError(Text(NoticeCode.DISK_SILENT, path=str(self._path), limit_s=self._limit_s))

    def _outcome(self) -> OnDisk:
        if self._error is not None:
            raise self._error
        return self._found[0]

    # In the thread ---------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        _CURRENT.set(self)
        try:
            self._found.append(self._work())
        except BaseException as error:  # noqa: BLE001 - raised where it is waited for
            self._error = error
        with self._changed:
            self._ended = True
            self._changed.notify_all()
            self._tell()
            abandoned = self._abandoned
        if abandoned and self._found:
            self._unwanted(self._found[0])

    def suspend(self, whether: bool) -> None:
        """The limit does not count, or counts again, from now on."""
        with self._changed:
            self._since_s = None if whether else time.monotonic()
            self._changed.notify_all()
            self._tell()


async def _passed_on(stop: asyncio.Event, told: asyncio.Event) -> None:
    await stop.wait()
    told.set()


async def _within(limit_s: float, told: asyncio.Event) -> None:
    with suppress(TimeoutError):
        async with asyncio.timeout(None if math.isinf(limit_s) else limit_s):
            await told.wait()


_CURRENT: ContextVar[DiskWork[Any] | None] = ContextVar("_CURRENT", default=None)


@contextmanager
def long_work() -> Iterator[None]:
    """Inside, a thread is at work on a disk that answers, for as long as that takes: a migration, a repair."""
    current = _CURRENT.get()
    if current is not None:
        current.suspend(True)
    try:
        yield
    finally:
        if current is not None:
            current.suspend(False)


def answered(path: Path, work: Callable[[], OnDisk]) -> OnDisk:
    """What `work` finds at the path. Raises what it raises, or StoreError when the disk does not answer in time."""
    return DiskWork(path, work).wait()
