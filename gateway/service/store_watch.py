"""Reports when storing fails, works again, or the disk fills up."""

import logging
from collections.abc import Callable

from gateway.config.sections import Storage
from gateway.model.events import Sink, StorageChanged, StoreHealth
from gateway.runtime.clocks import ServiceClock
from gateway.runtime.periodic import Periodic
from gateway.runtime.problems import Notice, Notify, Problems

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
        self._notify = notify
        self._low, self._mended = False, ""
        self._told = ("", False)

    async def run(self) -> None:
        """Run until cancelled."""
        await self._periodic.run(self._look)

    async def _look(self, _: float) -> None:
        health, path = self._health(), self._settings.path
        if health.problem:
            text = f"storage: {path}: {health.problem}; rows wait in memory, raw readings go first when they are many"
            self._problems.report(_STORE, health.problem, text)
        else:
            self._problems.clear(_STORE, f"storage: {path} is written again")
        if health.mended != self._mended:
            self._mended = health.mended
            log.error("%s", health.mended)
            self._notify(Notice("database", health.mended))
        limit_mb = self._settings.warn_free_mb
        if health.free_mb is not None:
            self._low = health.free_mb < limit_mb * (_ENOUGH if self._low else 1.0)
            if self._low:
                text = f"storage: {health.free_mb:.0f} MB are free on the disk of {path}, less than {limit_mb:g}"
                self._problems.report(_DISK, "low", f"{text}: delete something or lower [storage] keep_samples_days")
            else:
                self._problems.clear(_DISK, f"storage: {health.free_mb:.0f} MB are free on the disk of {path} again")
        now = health.problem, self._low
        if now != self._told or health.problem:
            self._told = now
            self._sink(StorageChanged(health))
