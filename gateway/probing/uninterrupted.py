"""Requests to the control that a cancelled task still completes."""

import asyncio
from collections.abc import Coroutine
from contextlib import suppress
from typing import TypeVar

from drivers.base import DriverError

T = TypeVar("T")


async def to_its_end(work: Coroutine[object, object, T]) -> T:
    """Await `work` to its end, even when the caller is cancelled meanwhile; the cancellation then takes effect.

    After half a request nobody knows what is in force, and a line whose answers come in turn must be closed. A second
    cancel does reach the work.
    """
    task = asyncio.create_task(work)
    try:
        return await asyncio.shield(task)
    except asyncio.CancelledError:
        with suppress(DriverError):  # the caller is gone and cannot receive it
            await task
        raise
