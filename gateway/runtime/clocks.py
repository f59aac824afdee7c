"""Clocks of the service: the computer's, or a simulated one that the command line passes in."""

import asyncio
from contextlib import AbstractContextManager, nullcontext
from functools import cache
from pathlib import Path
from typing import Protocol

from drivers.base import Clock, SystemClock
from gateway.runtime.time_service import clock_synchronised


class ServiceClock(Clock, Protocol):
    """A clock that the service can also wait on."""

    async def sleep_until(self, monotonic_s: float) -> None:
        """Return when `monotonic()` has reached the given value."""
        ...

    def hold(self) -> AbstractContextManager[None]:
        """While inside, simulated time stands still.

        Otherwise a fast-forwarded clock would turn milliseconds of computing into minutes of machine time, which no
        real gateway sees. On the real clock this does nothing.
        """
        ...

    def synchronised(self) -> bool:
        """Whether `utc()` is known to be right, as far as ages of minutes need it."""
        ...

    def origin(self) -> str:
        """Name of what `monotonic()` counts from: values with the same origin can be subtracted, also in two runs."""
        ...


class RealClock(SystemClock):
    """The computer's own clocks."""

    async def sleep_until(self, monotonic_s: float) -> None:
        await asyncio.sleep(max(0.0, monotonic_s - self.monotonic()))

    def hold(self) -> AbstractContextManager[None]:
        return nullcontext()

    def synchronised(self) -> bool:
        return clock_synchronised() is True

    def origin(self) -> str:
        return _kernel_boot()


@cache
def _kernel_boot() -> str:
    return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
