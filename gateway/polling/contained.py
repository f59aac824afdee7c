"""Contains a driver library's own cancellations, so that none of them reaches the calling task unnoticed."""

import asyncio
from collections.abc import Awaitable
from typing import TypeVar

T = TypeVar("T")


async def uncancelled(work: Awaitable[T]) -> T:
    """Await a driver. Raises RuntimeError for a cancellation that nobody requested.

    A library that closes its connection cancels the futures of its own requests. Passed on, that would silently end the
    calling task as if it had been cancelled.
    """
    try:
        return await work
    except asyncio.CancelledError as error:
        task = asyncio.current_task()
        if task is None or task.cancelling():
            raise
        raise RuntimeError("the library cancelled its own request") from error
