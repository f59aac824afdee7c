"""Reports that the computer's clock is not synchronised after a start, and for how long it was off once it is."""

import logging
import math
from collections.abc import Callable

from gateway.model.codes import NoticeCode
from gateway.model.notice import Notify
from gateway.model.text import Text
from gateway.runtime.ages import Ages
from gateway.runtime.clocks import ServiceClock
from gateway.runtime.periodic import Periodic
from gateway.runtime.problems import Problems

log = logging.getLogger(__name__)

_PERIOD_S = 10.0
_CLOCK = "clock"


class ClockWatch:
    """Looks until the clock is known to be right; from then on the monotonic clock is enough.

    Parameters
    ----------
    ages: of what an earlier run left
    clock: for the time between two looks
    notify: called at the problem's begin and end
    known: called once when the clock is known to be right, if it was not at the start
    """

    def __init__(self, ages: Ages, clock: ServiceClock, notify: Notify, known: Callable[[], None]) -> None:
        self._ages, self._clock, self._known = ages, clock, known
        self._problems = Problems(clock, _PERIOD_S, notify, log)
        self._waiting = not ages.known

    @property
    def unknown(self) -> bool:
        """Whether the clock may be wrong."""
        return self._waiting

    async def run(self) -> None:
        """Run until cancelled."""
        await Periodic(self._clock, _PERIOD_S).run(self._look)

    async def _look(self, _: float) -> None:
        if not self._waiting:
            return
        if not self._ages.known:
            self._problems.report(_CLOCK, self._unknown_text(), "unknown")
            return
        self._waiting = False
        self._known()
        pause_s = self._ages.pause_s
        if math.isinf(pause_s):
            self._problems.clear(_CLOCK, NoticeCode.CLOCK_RIGHT)
        else:
            self._problems.clear(_CLOCK, NoticeCode.CLOCK_RIGHT_AFTER, pause_s=pause_s)

    def _unknown_text(self) -> Text:
        if math.isinf(self._ages.pause_s):
            return Text(NoticeCode.CLOCK_AND_PAUSE_UNKNOWN, least_s=self._clock.monotonic())
        return Text(NoticeCode.CLOCK_UNKNOWN)
