"""Asking a device of another program as the service does: again, when it is later than usual."""

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from typing import TypeVar

from drivers.base import Driver, NoAnswer, Reading

LIMIT_S = 60.0

Answer = TypeVar("Answer")


async def answered(ask: Callable[[bool], Awaitable[Answer]]) -> Answer:
    """The answer to a question, which is told whether it continues with one that was not answered.

    On a serial line the driver learns from the first answer to wait no longer than 50 ms, and leaves it to who polls to
    ask again; a late answer is as good. On a busy computer another program is later now and then.

    Raises TimeoutError.
    """
    again = False
    async with asyncio.timeout(LIMIT_S):
        while True:
            try:
                return await ask(again)
            except NoAnswer:
                again = True


async def readings_of(driver: Driver) -> Sequence[Reading]:
    """One of each channel, asked for until the device answers. Raises TimeoutError."""
    return await answered(lambda again: driver.read(again=again))
