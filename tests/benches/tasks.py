"""Tasks that run for as long as a test observes them."""

import asyncio
from collections.abc import AsyncIterator, Coroutine
from contextlib import asynccontextmanager


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
