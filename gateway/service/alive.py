"""Checks that every critical loop of the service makes progress: one that has not slept for too long is stuck.

Every critical loop waits on the service's clock between two rounds of work, so the clock sees all of them.
"""

import asyncio
import logging
from collections.abc import Mapping
from contextlib import AbstractContextManager
from datetime import datetime

from gateway.model.codes import NoticeCode
from gateway.model.text import Text
from gateway.runtime.clocks import ServiceClock
from gateway.service.service_manager import ServiceManager

log = logging.getLogger(__name__)


class WatchedClock:
    """A service clock that remembers which tasks wait on it.

    Parameters
    ----------
    clock: does the waiting
    """

    def __init__(self, clock: ServiceClock) -> None:
        self._clock = clock
        self._longest_s: dict[str, float] = {}
        self._awake_since_s: dict[str, float] = {}
        """By name of the task; absent: it waits."""

    def expect(self, works_s: Mapping[str, float]) -> None:
        """Watch the tasks of these names from now on. A new one must wait within its longest work."""
        new = works_s.keys() - self._longest_s.keys()
        self._longest_s = dict(works_s)
        self._awake_since_s |= dict.fromkeys(new, self._clock.monotonic())

    def stuck(self) -> list[str]:
        """The loops that have worked for too long, or have ended."""
        now_s = self._clock.monotonic()
        return [
            name
            for name, longest_s in self._longest_s.items()
            if now_s - self._awake_since_s.get(name, now_s) > longest_s
        ]

    async def sleep_until(self, monotonic_s: float) -> None:
        """Return when `monotonic()` has reached the given value."""
        task = asyncio.current_task()
        name = "" if task is None else task.get_name()
        self._awake_since_s.pop(name, None)
        try:
            await self._clock.sleep_until(monotonic_s)
        finally:
            if name in self._longest_s:
                self._awake_since_s[name] = self._clock.monotonic()

    def monotonic(self) -> float:
        """Seconds of the watched clock."""
        return self._clock.monotonic()

    def utc(self) -> datetime:
        """Time of the watched clock."""
        return self._clock.utc()

    def hold(self) -> AbstractContextManager[None]:
        """See ServiceClock."""
        return self._clock.hold()

    def synchronised(self) -> bool:
        """See ServiceClock."""
        return self._clock.synchronised()

    def origin(self) -> str:
        """See ServiceClock."""
        return self._clock.origin()


async def feed(manager: ServiceManager, every_s: float, clock: WatchedClock, stop: asyncio.Event) -> None:
    """Notify systemd while every loop runs, or while the service stops; otherwise log which loops are stuck."""
    told: list[str] = []
    while True:
        stuck = [] if stop.is_set() else clock.stuck()
        if not stuck:
            manager.alive()
        elif stuck != told:
            log.critical("%s", Text(NoticeCode.LOOPS_STUCK, loops=sorted(stuck)))
        told = stuck
        await asyncio.sleep(every_s)
