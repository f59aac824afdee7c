"""An event loop on which one can wait until it has nothing to do. Every `async def` test runs on one."""

import asyncio
from collections.abc import Callable, Coroutine
from selectors import DefaultSelector, SelectorKey
from typing import Any, TypeVar

T = TypeVar("T")

_LIMIT_S = 300.0
"""By the loop's clock, for what goes over a wire in one period, and for what is computed meanwhile."""


class _TellingSelector(DefaultSelector):
    """Before its loop waits, it ends the wait for that."""

    def __init__(self) -> None:
        super().__init__()
        self.waiting: tuple[asyncio.Future[None], Callable[[], bool]] | None = None

    def select(self, timeout: float | None = None) -> list[tuple[SelectorKey, int]]:
        """A loop asks with 0 while callbacks are due."""
        if timeout == 0 or self.waiting is None or not self.waiting[1]():
            return super().select(timeout)
        if not (arrived := super().select(0)):
            future, self.waiting = self.waiting[0], None
            if not future.done():  # it may be cancelled
                future.set_result(None)
        return arrived


class IdleLoop(asyncio.SelectorEventLoop):
    """A loop of which one can tell that it is idle: no callback is due, and nothing has arrived. Timers that are due
    later do not count."""

    def __init__(self) -> None:
        self._telling = _TellingSelector()
        super().__init__(self._telling)

    async def idle(self, holds: Callable[[], bool]) -> None:
        waiting = self._telling.waiting
        assert waiting is None or waiting[0].done(), "one wait at a time: what ends the first is work for the second"
        future = self.create_future()
        self._telling.waiting = (future, holds)
        await future


async def idle(holds: Callable[[], bool] = lambda: True) -> None:
    """Return once the running loop is idle and this holds too, which must change in the loop's own thread.

    Raises TimeoutError after some minutes: a task may never rest.
    """
    loop = asyncio.get_running_loop()
    assert isinstance(loop, IdleLoop), "not a loop of tests.benches.idle_loop.run"
    async with asyncio.timeout(_LIMIT_S):
        await loop.idle(holds)


def run(main: Coroutine[Any, Any, T]) -> T:
    """As asyncio.run."""
    with asyncio.Runner(loop_factory=IdleLoop) as runner:
        return runner.run(main)
