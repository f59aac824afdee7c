"""The acquisition: one runner per bus and the watch for stale values, started, exchanged and stopped together."""

from collections.abc import Collection, Mapping, Sequence
from itertools import count
from types import TracebackType
from typing import Self

from gateway.acquisition.board import Board
from gateway.acquisition.line import Line
from gateway.acquisition.runner import BusRunner, Publish
from gateway.acquisition.stale import StaleWatch
from gateway.model.notice import Notify
from gateway.runtime.clocks import ServiceClock
from gateway.runtime.parts import WORK_S, Part, Parts


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
    before: receive each device's readings before `publish` does
    expired: receives the readings of all devices that have gone stale; None: `publish` does
    parts: of the service, among which the runners are; None: of its own
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
        before: Sequence[Publish] = (),
        expired: Publish | None = None,
        parts: Parts | None = None,
    ) -> None:
        self._clock, self._publish, self._notify, self._quiet = clock, publish, notify, quiet
        self._sequence = count(1).__next__
        self.board = Board(_periods_s(lines)) if board is None else board
        self._before = (self.board.put, *before)
        stale = StaleWatch(self.board, clock, self._sequence, publish if expired is None else expired)
        self._runners = dict[str, BusRunner]()
        self._parts = Parts() if parts is None else parts
        self._parts.add(*map(self._part, lines), Part("stale", stale.run, works_s=WORK_S))

    @property
    def runners(self) -> Mapping[str, BusRunner]:
        """The runners, by name of the bus."""
        return dict(self._runners)

    async def __aenter__(self) -> Self:
        await self._parts.__aenter__()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool | None:
        return await self._parts.__aexit__(kind, error, trace)

    async def exchange(self, stop: Collection[str], start: Sequence[Line]) -> None:
        """While running: end the runners of some buses, close these, then begin others. The rest is not affected.

        Stopping comes first, because a new bus may use the port of an old one.
        """
        for name in stop:
            del self._runners[name]
        await self._parts.exchange([_name(bus) for bus in stop], ())
        self._parts.add(*map(self._part, start))

    def _part(self, line: Line) -> Part:
        runner = BusRunner(
            line, self._clock, self._publish, self._notify, self._sequence, before=self._before, quiet=self._quiet
        )
        self._runners[line.bus.name] = runner
        return Part(_name(line.bus.name), runner.run, works_s=WORK_S + line.read_limit_s * len(line.drivers))


def _name(bus: str) -> str:
    return f"bus {bus}"


def _periods_s(lines: Sequence[Line]) -> dict[str, float]:
    """Each channel's polling period."""
    return {channel: line.period_s for line in lines for driver in line.drivers for channel in driver.channels}
