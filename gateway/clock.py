"""Clocks of the service: the computer's, or a simulated one that the command line passes in."""

import asyncio
from contextlib import AbstractContextManager, nullcontext
from typing import Protocol

from drivers.base import Clock, SystemClock


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


class RealClock(SystemClock):
    """The computer's own clocks."""

    async def sleep_until(self, monotonic_s: float) -> None:
        await asyncio.sleep(max(0.0, monotonic_s - self.monotonic()))

    def hold(self) -> AbstractContextManager[None]:
        return nullcontext()
