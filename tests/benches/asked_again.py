"""Asking a device of another program as the service does: again, when it is later than usual."""

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from typing import TypeVar

from drivers.base import Driver, NoAnswer, Reading

LIMIT_S = 60.0
MOST_REPEATS = 20
"""Most repeats of one question. The waiting grows to a timeout of some seconds: about as many fit into LIMIT_S."""

Answer = TypeVar("Answer")


async def answered(ask: Callable[[bool], Awaitable[Answer]]) -> Answer:
    """The answer to a question, which is told whether it continues with one that was not answered.

    On a serial line the driver learns from the first answer to wait no longer than 50 ms, and leaves it to who polls to
    ask again; a late answer is as good. On a busy computer another program is later now and then.

    Raises NoAnswer after MOST_REPEATS, TimeoutError after LIMIT_S.
    """
    async with asyncio.timeout(LIMIT_S):
        for repeats in range(MOST_REPEATS):
            with suppress(NoAnswer):
                return await ask(repeats > 0)
        return await ask(True)


async def readings_of(driver: Driver) -> Sequence[Reading]:
    """One of each channel, asked for until the device answers. Raises as `answered` does."""
    return await answered(lambda again: driver.read(again=again))
