"""Parts of a program: named tasks that are started, exchanged, stopped and listed in one place."""

import asyncio
from collections.abc import Awaitable, Callable, Collection, Coroutine, Mapping, Sequence
from contextlib import AsyncExitStack
from types import TracebackType
from typing import Any, NamedTuple, Self

WORK_S = 60.0
"""A part works no longer than this without waiting on the clock, apart from the reads of a bus."""


class Part(NamedTuple):
    """A task that runs until it is cancelled."""

    name: str
    run: Callable[[], Coroutine[Any, Any, None]]
    after: Callable[[], Awaitable[None]] | None = None
    """Called when every part has ended; None: nothing is left to do."""
    works_s: float | None = None
    """It never works longer than this without waiting on the clock; None: it waits for something else."""


class Parts:
    """The parts run inside this async context manager, and on exit all are stopped.

    An error that ends one of them ends them all; the exceptions are raised as a group.
    """

    def __init__(self) -> None:
        self._parts: dict[str, Part] = {}
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._stack = AsyncExitStack()
        self._group: asyncio.TaskGroup | None = None

    @property
    def running(self) -> bool:
        """Whether they run, and none of them is being stopped with all the others."""
        return self._group is not None

    @property
    def works_s(self) -> Mapping[str, float]:
        """Of those that wait on the clock, by name: how long they work at most."""
        return {part.name: part.works_s for part in self._parts.values() if part.works_s is not None}

    def add(self, *parts: Part) -> None:
        """More of them, which start at once if the others run. Raises ValueError for a name that there is."""
        for part in parts:
            if part.name in self._parts:
                raise ValueError(f"there is a part {part.name!r} already")
            self._parts[part.name] = part
            if self._group is not None:
                self._tasks[part.name] = self._group.create_task(part.run(), name=part.name)

    async def exchange(self, stop: Collection[str], start: Sequence[Part]) -> None:
        """End some, and then start others, which may have the same names; the rest is not affected."""
        ending = [self._tasks.pop(name) for name in stop]
        for name, task in zip(stop, ending, strict=True):
            del self._parts[name]
            task.cancel()
        if ending:
            await asyncio.wait(ending)
        self.add(*start)

    async def __aenter__(self) -> Self:
        for part in self._parts.values():
            if part.after is not None:
                self._stack.push_async_callback(part.after)
        self._group = await self._stack.enter_async_context(asyncio.TaskGroup())
        for name, part in self._parts.items():
            self._tasks[name] = self._group.create_task(part.run(), name=name)
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool | None:
        self._group = None
        for task in self._tasks.values():
            task.cancel()
        return await self._stack.__aexit__(kind, error, trace)
