"""Signals that end a command."""

import asyncio
import signal
from collections.abc import AsyncIterator
from contextlib import suppress
from queue import SimpleQueue
from threading import Event, Thread
from time import monotonic


def stop_on_signals(stop: asyncio.Event) -> None:
    """SIGINT and SIGTERM set `stop`; a second SIGINT ends the process at once."""
    loop = asyncio.get_running_loop()

    def asked() -> None:
        stop.set()
        loop.remove_signal_handler(signal.SIGINT)

    loop.add_signal_handler(signal.SIGINT, asked)
    loop.add_signal_handler(signal.SIGTERM, stop.set)


def set_on_signals(stop: Event) -> None:
    """SIGINT and SIGTERM set `stop`, for a command without an event loop.

    The handler itself must not: it runs in the main thread, which may be within `stop.wait` and hold the event's lock.
    """
    asked: SimpleQueue[None] = SimpleQueue()  # whose put may interrupt itself

    def wait() -> None:
        asked.get()
        stop.set()

    Thread(target=wait, name="signals", daemon=True).start()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: asked.put(None))


async def until(stop: asyncio.Event, every_s: float, seconds: float | None) -> AsyncIterator[None]:
    """Yields every `every_s`, and a last time when `stop` is set or the given seconds have passed (None: unlimited)."""
    end_s = None if seconds is None else monotonic() + seconds
    while not stop.is_set() and (end_s is None or monotonic() < end_s):
        left_s = every_s if end_s is None else min(every_s, max(0.0, end_s - monotonic()))
        with suppress(TimeoutError):
            await asyncio.wait_for(stop.wait(), left_s)
        yield
