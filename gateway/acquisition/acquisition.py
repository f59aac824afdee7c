"""The acquisition: one runner per bus and the watch for stale values, started, exchanged and stopped together."""

import asyncio
from collections.abc import Collection, Mapping, Sequence
from contextlib import AsyncExitStack
from itertools import count
from types import TracebackType
from typing import Self

from gateway.acquisition.board import Board
from gateway.acquisition.line import Line
from gateway.acquisition.runner import BusRunner, Publish
from gateway.acquisition.stale import StaleWatch
from gateway.model.notice import Notify
from gateway.model.sample import Sample
from gateway.runtime.clocks import ServiceClock


class Acquisition:
    """One runner per bus, as an async context manager: they run inside it, and on exit all are stopped and closed.

    A value that is not renewed goes stale, even while a read hangs, whatever command reads the devices.
    An error that ends one runner ends them all; the exceptions are raised as a group.

    Parameters
    ----------
    lines: buses with their drivers; nothing is opened before the context is entered
    clock: real or simulated
    publish: receives each device's readings
    notify: receives problems as they begin and end
    quiet: problems are not logged, as `notify` shows them
    board: takes every reading before `publish` does, and says which have gone stale; None: one of its own
    expired: receives the readings of all devices that have gone stale; None: `publish` does
    """

    def __init__(
        self,
        lines: Sequence[Line],
        clock: ServiceClock,
        publish: Publish,
        notify: Notify,
        *,
        quiet: bool = False,
        board: Board | None = None,
        expired: Publish | None = None,
    ) -> None:
        self._clock, self._publish, self._notify, self._quiet = clock, publish, notify, quiet
        self._sequence = count(1).__next__
        self.board = Board(_periods_s(lines)) if board is None else board
        self._stale = StaleWatch(self.board, clock, self._sequence, publish if expired is None else expired)
        self._watching: asyncio.Task[None] | None = None
        self._runners = {line.bus.name: self._runner(line) for line in lines}
        self._stack = AsyncExitStack()
        self._group: asyncio.TaskGroup | None = None
        self._tasks: dict[str, asyncio.Task[None]] = {}

    @property
    def runners(self) -> Mapping[str, BusRunner]:
        """The runners, by name of the bus."""
        return dict(self._runners)

    async def __aenter__(self) -> Self:
        self._group = await self._stack.enter_async_context(asyncio.TaskGroup())
        for runner in self._runners.values():
            self._start(runner)
        self._watching = self._group.create_task(self._stale.run(), name="stale")
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool | None:
        for task in (*self._tasks.values(), self._watching):
            if task is not None:
                task.cancel()
        return await self._stack.__aexit__(kind, error, trace)

    async def exchange(self, stop: Collection[str], start: Sequence[Line]) -> None:
        """While running: end the runners of some buses, close these, then begin others. The rest is not affected.

        Stopping comes first, because a new bus may use the port of an old one.
        """
        ending = [self._tasks.pop(name) for name in stop]
        for name in stop:
            del self._runners[name]
        for task in ending:
            task.cancel()
        if ending:
            await asyncio.wait(ending)
        for line in start:
            self._runners[line.bus.name] = self._runner(line)
            self._start(self._runners[line.bus.name])

    def _runner(self, line: Line) -> BusRunner:
        return BusRunner(line, self._clock, self._take, self._notify, self._sequence, quiet=self._quiet)

    def _take(self, readings: Sequence[Sample]) -> None:
        self.board.put(readings)
        self._publish(readings)

    def _start(self, runner: BusRunner) -> None:
        if self._group is None:
            raise RuntimeError("the acquisition is not running: enter its context first")
        name = runner.line.bus.name
        self._tasks[name] = self._group.create_task(runner.run(), name=f"bus {name}")


def _periods_s(lines: Sequence[Line]) -> dict[str, float]:
    """Each channel's polling period."""
    return {channel: line.period_s for line in lines for driver in line.drivers for channel in driver.channels}
