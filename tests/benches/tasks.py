"""Tasks that run for as long as a test observes them."""

import asyncio
from collections.abc import AsyncIterator, Coroutine
from contextlib import asynccontextmanager

from gateway.service.service import Service


@asynccontextmanager
async def running(work: Coroutine[object, object, None]) -> AsyncIterator[None]:
    """The task runs inside, and is cancelled at the end; raises what it raised."""
    task = asyncio.create_task(work)
    try:
        yield
    finally:
        died = task.done()
        task.cancel()
        [error] = await asyncio.gather(task, return_exceptions=True)
    assert not died, error


@asynccontextmanager
async def served(service: Service) -> AsyncIterator[None]:
    """The service runs inside, and is stopped at the end."""
    stop = asyncio.Event()
    task = asyncio.create_task(service.run(stop))
    try:
        yield
    finally:
        stop.set()
        await task
