"""Asks a third-party device as the service does: again, when its answer is later than usual."""

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from typing import TypeVar

from drivers.base import Driver, NoAnswer, Reading

LIMIT_S = 60.0
MOST_REPEATS = 20
"""The most repeats of one question. The waits grow to a timeout of some seconds, so about as many fit into LIMIT_S."""

Answer = TypeVar("Answer")


async def answered(ask: Callable[[bool], Awaitable[Answer]]) -> Answer:
    """The answer to a question; the question gets whether it repeats one that was not answered.

    On a serial line the driver learns from the first answer to wait no longer than 50 ms, and leaves it to the poller
    to ask again; a late answer is as good. On a busy computer another program is late now and then.

    Raises NoAnswer after MOST_REPEATS, TimeoutError after LIMIT_S.
    """
    async with asyncio.timeout(LIMIT_S):
        for repeats in range(MOST_REPEATS):
            with suppress(NoAnswer):
                return await ask(repeats > 0)
        return await ask(True)


async def readings_of(driver: Driver) -> Sequence[Reading]:
    """A reading of each channel; asks until the device answers. Raises as `answered` does."""
    return await answered(lambda again: driver.read(again=again))
