"""An emulated device or control that answers for as long as a test needs it."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Protocol, TypeVar

Place = TypeVar("Place")
Place_co = TypeVar("Place_co", covariant=True)


class Server(Protocol[Place_co]):
    """Answers at the place that its start returns."""

    async def start(self) -> Place_co: ...

    async def stop(self) -> None: ...


@asynccontextmanager
async def started(server: Server[Place]) -> AsyncIterator[Place]:
    """It answers inside, at this place."""
    place = await server.start()
    try:
        yield place
    finally:
        await server.stop()
