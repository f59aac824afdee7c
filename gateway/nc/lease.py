"""The right to write offsets to one control: claimed, kept by a heartbeat each period, released at the end."""

import logging
import math

from drivers.base import NoAnswer
from drivers.nc import NumericalControl, WatchdogTerms
from gateway.config.sections import Compensation
from gateway.model.codes import NoticeCode
from gateway.model.notice import Notice, Notify
from gateway.model.text import Text
from gateway.nc.settings import Identity
from gateway.nc.states import RIGHTS, Reply, Right, after
from gateway.runtime.clocks import ServiceClock
from gateway.runtime.problems import Problems

log = logging.getLogger(__name__)

_WATCHDOG = "watchdog of NC"


class Lease:
    """One gateway's lease of one control's offsets; gateway.nc.states has its state table.

    Parameters
    ----------
    identity: numbers of this gateway's run and of the one before it
    settings: mode, watchdog_s, slew_um_per_s and when_stale are used
    problems: told whether the control's watchdog is active
    notify: called with what happens to the offsets
    """

    def __init__(
        self,
        nc: NumericalControl,
        clock: ServiceClock,
        identity: Identity,
        settings: Compensation,
        problems: Problems,
        notify: Notify,
    ) -> None:
        self._nc, self._clock, self._problems, self._notify = nc, clock, problems, notify
        self._owner, self._predecessor = identity.owner, identity.predecessor
        ramp_um_per_s = settings.slew_um_per_s if settings.when_stale == "zero" else 0.0
        self._terms = WatchdogTerms(settings.watchdog_s, ramp_um_per_s, settings.slew_um_per_s)
        self._right = Right.UNCLAIMED if settings.mode == "compensate" else Right.NONE
        self._heard_before: bool | None = None
        self._beat_s = -math.inf
        self._before_s = -math.inf
        """Before the control's last beat."""

    @property
    def right(self) -> Right:
        """Whether this gateway may write."""
        return self._right

    @property
    def armed(self) -> bool:
        """Whether this gateway writes offsets as soon as the control permits it."""
        return self._right not in (Right.NONE, Right.DISARMED)

    @property
    def taken_back(self) -> bool:
        """Whether it is disarmed and the control's watchdog ramps the offsets to zero."""
        return self._right is Right.DISARMED and self._terms.ramp_um_per_s > 0

    async def claim(self) -> None:
        """Become the only gateway that writes, if the mode requires it. Raises DriverError; Refused if another is."""
        if self.armed:
            self._before_s = self._clock.monotonic()
            await self._nc.claim(self._owner, self._terms, self._predecessor)
            self._right = after(RIGHTS, self._right, Reply.CLAIMED)

    async def beat(self) -> bool:
        """Send a heartbeat; returns whether offsets may be written. False if the control's watchdog was not active
        until this beat, so that the offsets may have moved. Raises DriverError.

        A driver that reads the watchdog's state and then writes the beat does not see a silence in between: from one
        beat to the answer to the next it must not have been possible.
        """
        began = self._clock.monotonic()
        heard = await self._nc.heartbeat(self._owner)
        heard = heard and self._clock.monotonic() - self._before_s < self._terms.silence_s
        self._beat_s = self._before_s = began  # not now: this process may have been suspended since the control got it
        self._right = after(RIGHTS, self._right, Reply.HEARD if heard else Reply.UNHEARD)
        if heard:
            self._problems.clear(_WATCHDOG, NoticeCode.NC_WATCHDOG_HEARD)
        elif self._heard_before is not None:  # the first may be too early
            code = NoticeCode.NC_WATCHDOG_UNHEARD if self._heard_before else NoticeCode.NC_WATCHDOG_SILENT
            self._problems.report(_WATCHDOG, Text(code), "unheard")
        self._heard_before = heard
        return heard

    def check_fresh(self) -> None:
        """Raises NoAnswer if this process was suspended since its beat: the control may have moved the offsets."""
        if self._clock.monotonic() - self._beat_s > self._terms.silence_s / 2:
            raise NoAnswer(Text(NoticeCode.HEARTBEAT_OLD, s=self._terms.silence_s / 2), device="nc")

    def tell(self, text: Text) -> None:
        """Report what happened to the offsets; this gateway still writes."""
        log.warning("%s", text)
        self._notify(Notice("late write to NC", text, at_s=self._clock.monotonic()))

    def disarm(self, text: Text) -> None:
        """Stop writing and sending heartbeats: the control's watchdog brings the offsets to their configured state."""
        self._right = after(RIGHTS, self._right, Reply.DISARM)
        log.warning("%s", text)
        self._notify(Notice("offsets of NC", text, at_s=self._clock.monotonic()))

    def lost(self) -> None:
        """The connection is closed; the control keeps the claim until its watchdog finds this gateway silent."""
        self._right = after(RIGHTS, self._right, Reply.LOST)

    async def release(self) -> None:
        """Release the control. Raises DriverError."""
        if self.armed:
            await self._nc.release(self._owner)
