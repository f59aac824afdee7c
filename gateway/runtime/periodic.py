"""A period without drift: when the next one begins, and how many were missed because one took too long."""

import math
from collections.abc import Awaitable, Callable

from gateway.runtime.clocks import ServiceClock


class Periodic:
    """Begins a period every `period_s`, counted from the first, however long the work of one takes.

    Periods that would begin while another is still at work are skipped and counted; the next one begins when it is due.

    Parameters
    ----------
    clock: real or simulated
    period_s: s, > 0
    first_s: monotonic seconds of the first period; None: when it is first waited for
    phase_s: delay of all periods after the first, s, >= 0 and < period_s
    """

    def __init__(
        self, clock: ServiceClock, period_s: float, *, first_s: float | None = None, phase_s: float = 0.0
    ) -> None:
        if not (period_s > 0 and 0 <= phase_s < period_s):
            raise ValueError(f"period_s = {period_s:g}, phase_s = {phase_s:g}: expected 0 <= phase < period")
        self._clock, self._period_s = clock, period_s
        self._due_s = first_s
        self._phase_s = phase_s
        """Not yet applied."""
        self.missed = 0
        """Periods that were skipped since the beginning."""

    async def wait(self) -> float:
        """Wait until the period begins; returns the monotonic seconds at which it was due."""
        due_s = self._due_s = self._clock.monotonic() if self._due_s is None else self._due_s
        await self._clock.sleep_until(due_s)
        return due_s

    def done(self) -> int:
        """The period's work is done: advance to the next one. Returns how many periods are skipped.

        Raises ValueError if the first period has not been waited for.
        """
        if self._due_s is None:
            raise ValueError("no period has begun: wait for it first")
        due_s, now_s = self._due_s, self._clock.monotonic()
        if self._phase_s:
            # The second period begins this long after the first; work that lasts longer has missed no whole period.
            due_s, self._phase_s = due_s + self._phase_s, 0.0
            if now_s <= due_s:
                due_s -= self._period_s
        late = max(0, math.ceil((now_s - due_s) / self._period_s) - 1)
        self._due_s = due_s + self._period_s * (1 + late)
        self.missed += late
        return late

    async def run(
        self, work: Callable[[float], Awaitable[None]], worked: Callable[[int], None] = lambda _: None
    ) -> None:
        """Work once per period until cancelled; simulated time stands still meanwhile.

        work: called with the monotonic seconds at which the period was due
        worked: called after each period's work, with the number of periods that were skipped because of it
        """
        while True:
            due_s = await self.wait()
            with self._clock.hold():
                await work(due_s)
            worked(self.done())
