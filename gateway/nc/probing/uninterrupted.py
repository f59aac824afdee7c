"""Requests to the control that are completed even if the task is cancelled."""

import asyncio
from collections.abc import Coroutine
from contextlib import suppress
from typing import TypeVar

from drivers.base import DriverError

T = TypeVar("T")


async def to_its_end(work: Coroutine[object, object, T]) -> T:
    """Await `work` to its end, even if the caller is cancelled meanwhile; the cancellation then takes effect.

    After half a request it is unknown what is in force, and a connection with ordered answers must be closed. A second
    cancellation does reach the work.
    """
    task = asyncio.create_task(work)
    try:
        return await asyncio.shield(task)
    except asyncio.CancelledError:
        with suppress(DriverError):  # the caller has been cancelled and cannot receive it
            await task
        raise
