"""Simulated time for a process in which nothing goes over a wire."""

import asyncio
from collections.abc import Callable, Coroutine
from selectors import DefaultSelector, SelectorKey
from typing import Any, TypeVar

from tests.benches.stepped_clock import SteppedClock

T = TypeVar("T")


class _TellingSelector(DefaultSelector):
    """The selector of a loop that calls `idle` when it has nothing to do; True: now it has."""

    def __init__(self, idle: Callable[[], bool]) -> None:
        super().__init__()
        self._idle = idle

    def select(self, timeout: float | None = None) -> list[tuple[SelectorKey, int]]:
        """A loop asks with 0 while callbacks are due."""
        return super().select(timeout if timeout == 0 or not self._idle() else 0)


class LoopClock(SteppedClock):
    """Time advances as soon as the event loop has nothing to do. There is no wire with bytes on their way."""

    def __init__(self) -> None:
        super().__init__()
        self._resting: asyncio.Future[None] | None = None

    def run(self, main: Coroutine[Any, Any, T]) -> T:
        """As asyncio.run. `run_until` works only in here."""
        with asyncio.Runner(loop_factory=lambda: asyncio.SelectorEventLoop(_TellingSelector(self._idle))) as runner:
            return runner.run(main)

    async def rest(self) -> None:
        assert self._resting is None or self._resting.done(), "one `run_until` at a time"
        self._resting = asyncio.get_running_loop().create_future()
        await self._resting

    def _idle(self) -> bool:
        resting = self._resting
        if resting is None or self.holds:
            return False
        self._resting = None
        if not resting.done():  # it may be cancelled
            resting.set_result(None)
        return True
