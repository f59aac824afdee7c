"""Signals that end a command."""

import asyncio
import signal
from collections.abc import AsyncIterator
from contextlib import suppress
from time import monotonic


def stop_on_signals(stop: asyncio.Event) -> None:
    """SIGINT and SIGTERM set `stop`; a second SIGINT ends the process at once."""
    loop = asyncio.get_running_loop()

    def asked() -> None:
        stop.set()
        loop.remove_signal_handler(signal.SIGINT)

    loop.add_signal_handler(signal.SIGINT, asked)
    loop.add_signal_handler(signal.SIGTERM, stop.set)


async def until(stop: asyncio.Event, every_s: float, seconds: float | None) -> AsyncIterator[None]:
    """Yields every `every_s`, and a last time when `stop` is set or the given seconds have passed (None: unlimited)."""
    end_s = None if seconds is None else monotonic() + seconds
    while not stop.is_set() and (end_s is None or monotonic() < end_s):
        left_s = every_s if end_s is None else min(every_s, max(0.0, end_s - monotonic()))
        with suppress(TimeoutError):
            await asyncio.wait_for(stop.wait(), left_s)
        yield
