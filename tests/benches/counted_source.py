"""A source of values that counts how often its device was read, so that a test can wait for that."""

import asyncio
from collections.abc import Sequence


class CountedSource:
    """The same values at each read."""

    def __init__(self, values: Sequence[float]) -> None:
        self._values, self._count, self._news = list(values), 0, asyncio.Event()

    def __call__(self) -> Sequence[float]:
        self._count += 1
        self._news.set()
        return self._values

    async def reads(self, count: int) -> None:
        """Wait until there were this many reads since the call."""
        wanted = self._count + count
        while self._count < wanted:
            self._news.clear()
            await self._news.wait()
