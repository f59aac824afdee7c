"""Reports when storing fails, works again, or the disk fills up."""

import logging
from collections.abc import Callable

from gateway.config.sections import Storage
from gateway.model.codes import NoticeCode
from gateway.model.events import Sink, StorageChanged, StoreHealth
from gateway.model.notice import Notice, Notify
from gateway.model.text import NOTHING, Text
from gateway.runtime.clocks import ServiceClock
from gateway.runtime.periodic import Periodic
from gateway.runtime.problems import Problems

log = logging.getLogger(__name__)

_STORE = "storage"
_DISK = "disk of storage"
_ENOUGH = 1.2
"""Above this many times the limit the disk counts as free again."""


class StoreWatch:
    """Checks the store's health once per period.

    Parameters
    ----------
    health: of the store
    settings: path and warn_free_mb are used
    period_s: between two checks, s
    notify: called with every problem as it begins and as it ends
    sink: receives StorageChanged when something changed, and at each check while rows wait for a store that fails
    """

    def __init__(
        self,
        health: Callable[[], StoreHealth],
        settings: Storage,
        clock: ServiceClock,
        period_s: float,
        notify: Notify,
        sink: Sink,
    ) -> None:
        self._health, self._settings, self._sink = health, settings, sink
        self._periodic = Periodic(clock, period_s)
        self._problems = Problems(clock, period_s, notify, log)
        self._notify, self._clock = notify, clock
        self._low, self._mended = False, NOTHING
        self._told = (NOTHING, False)

    async def run(self) -> None:
        """Run until cancelled."""
        await self._periodic.run(self._look)

    async def _look(self, _: float) -> None:
        health, path = self._health(), str(self._settings.path)
        if health.problem:
            text = Text(NoticeCode.STORE_FAILS, path=path, problem=health.problem)
            self._problems.report(_STORE, text, health.problem)
        else:
            self._problems.clear(_STORE, NoticeCode.STORE_WORKS, path=path)
        if health.mended != self._mended:
            self._mended = health.mended
            log.error("%s", health.mended)
            self._notify(Notice("database", health.mended, at_s=self._clock.monotonic()))
        limit_mb = self._settings.warn_free_mb
        if health.free_mb is not None:
            self._low = health.free_mb < limit_mb * (_ENOUGH if self._low else 1.0)
            if self._low:
                text = Text(NoticeCode.DISK_LOW, free_mb=health.free_mb, path=path, limit_mb=limit_mb)
                self._problems.report(_DISK, text)
            else:
                self._problems.clear(_DISK, NoticeCode.DISK_FREE, free_mb=health.free_mb, path=path)
        now = health.problem, self._low
        if now != self._told or health.problem:
            self._told = now
            self._sink(StorageChanged(health))
