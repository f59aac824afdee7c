"""Writes offsets to one control, step by step, only on top of its own last write, and reads each back."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from drivers.base import BadAnswer, ConnectError, NoAnswer
from drivers.nc import NcSnapshot, NotSendable
from gateway.config.sections import Compensation
from gateway.model.codes import NoticeCode
from gateway.model.compensation import Offsets, Source, Step, Write
from gateway.model.text import Text, failure
from gateway.nc.lease import Lease
from gateway.nc.routes import Form, differ, offsets_text, positions
from gateway.nc.slew import Slew, as_offsets
from gateway.runtime.clocks import ServiceClock
from talc.frame import FloatArray

_READINGS = 3
"""So many must agree before a ramp begins: nothing else tells a spoilt one, and two can be alike."""
_FADES = 2
"""For so many periods at most a watchdog that a beat has stopped may still take something away."""
_LATE_S = 10.0
"""A write without an answer may still arrive for at least this long. Until then the offsets stand where it would find
them, so that it is a step of one period's slew at most."""
_APART = 0.99
"""Two writes that the control does not slew act at least this share of a period apart."""
_WAITS = 0.1
"""For that the later one waits for this share of a period at most, or for the next period."""
_LATEST_S = 120.0
"""The offsets stand for at most this long, whatever the control says: TCP's maximum segment lifetime (RFC 9293)."""


class OffsetWriter:
    """One control's offsets.

    Parameters
    ----------
    form: how offsets go to this control
    lease: asked before every write, and disarmed by a mismatch
    settings: mode, bound_um, slew_um_per_s and when_stale are used
    period_s: time between two steps
    late_write_s: for how long the control lets a write without an answer take effect; 0: unknown
    store: called with every step that differs from the one before, and with every write that was not confirmed
    """

    def __init__(
        self,
        form: Form,
        lease: Lease,
        clock: ServiceClock,
        settings: Compensation,
        period_s: float,
        late_write_s: Callable[[], float],
        store: Callable[[Write], None],
    ) -> None:
        self._form, self._lease, self._clock = form, lease, clock
        self._settings, self._period, self._store = settings, period_s, store
        self._late_write_s = late_write_s
        self._slew: Slew | None = None
        self._left: FloatArray | None = None
        self._begun_at: tuple[float, FloatArray] | None = None
        """When the ramp began, and from what: one reading, which may be a spoilt one."""
        self._unanswered: FloatArray | None = None
        """The last write that got no answer, until it is seen in force."""
        self._until_s = -math.inf
        """Until when it may take effect."""
        self._acted_s = -math.inf
        """When the last write that was answered has taken effect at the latest."""
        self._last_step: Step | None = None

    @property
    def knows(self) -> bool:
        """Whether the offsets in force are known to be its own."""
        return self._left is not None

    @property
    def largest_um(self) -> float:
        """The largest offset of any axis at any position."""
        return self._begun.largest_um

    @property
    def _begun(self) -> Slew:
        if self._slew is None:
            raise RuntimeError("no step before begin()")
        return self._slew

    async def begin(self) -> None:
        """Start the ramp from whatever is in force on the control: no step at the start, and none after a reconnect.

        Raises DriverError; BadAnswer for an offset that is not a finite number.
        """
        self._begin_at(await self._form.read())

    def _begin_at(self, in_force: FloatArray) -> None:
        self._continue_from(in_force)
        self._left, self._begun_at = None, (self._clock.monotonic(), in_force)

    def _continue_from(self, in_force: FloatArray) -> None:
        """The next step begins there. Raises BadAnswer."""
        if not np.all(np.isfinite(in_force)):
            raise BadAnswer(Text(NoticeCode.IN_FORCE_NOT_FINITE, offsets=offsets_text(in_force)), device="nc")
        settings = self._settings
        self._slew = Slew(
            settings.bound_um,
            settings.slew_um_per_s,
            settings.when_stale,
            self._period,
            in_force,
            self._clock.monotonic(),
            together=self._form.together,
        )
        self._left = in_force

    def forget(self) -> None:
        """From now on the offsets in force may change without a write by this gateway."""
        self._left = None

    def stand(self, now_s: float, snapshot: NcSnapshot, source: Source, k: int | None) -> None:
        """A step that changes nothing and is not sent."""
        self._record(self._begun.freeze(now_s, self._here(snapshot), source), snapshot, k)

    def lost(self, snapshot: NcSnapshot, k: int | None) -> None:
        """The connection is lost: whoever follows the steps must not take the last one to be in force still."""
        if self._last_step is not None:
            self._record(replace(self._last_step, source=Source.AWAY), snapshot, k)

    async def follow(
        self,
        now_s: float,
        snapshot: NcSnapshot,
        wanted: FloatArray | None,
        source: Source,
        k: int | None,
        *,
        send: bool,
    ) -> None:
        """A step towards `wanted` (3, n), or towards the configured value for None. Raises DriverError.

        send: whether it goes to the control; it is stored in either case, even if the control does not answer
        k: grid index of the decision that it is based on
        """
        if send and source is not Source.STOPPED and await self._may_arrive(now_s):
            self.stand(now_s, snapshot, Source.UNANSWERED, k)
            return
        if send and await self._too_soon(now_s):
            self.stand(now_s, snapshot, source, k)
            return
        step = self._begun.follow(now_s, wanted, source, self._here(snapshot))
        if send:
            await self._send(step, snapshot, k)
        else:
            self._record(step, snapshot, k)

    async def _send(self, step: Step, snapshot: NcSnapshot, k: int | None) -> None:
        coefficients = np.array(step.coefficients_um)
        written, read_back = False, None
        try:
            self._lease.check_fresh()
            if await self._is_mine():
                written = True  # even if there is no answer
                written = await self._put(coefficients)
            if written:
                read_back = as_offsets((await self._read_back(coefficients) * self._here(snapshot)).sum(axis=1))
        finally:
            self._record(step, snapshot, k, written=written, read_back=read_back)

    async def _too_soon(self, now_s: float) -> bool:
        """Whether a write would act within one period of the last one, which came late because this process or the
        connection stood still: both together would be a step of two periods. A little earlier than due, it waits."""
        if self._form.together:
            return False  # the control slews
        due_s = self._acted_s + _APART * self._period
        if due_s - now_s > _WAITS * self._period:
            return True
        if now_s < due_s:
            await self._clock.sleep_until(due_s)
        return False

    async def _may_arrive(self, now_s: float) -> bool:
        """Whether a write without an answer may still change what is in force."""
        if self._unanswered is None or now_s >= self._until_s:
            return False
        self._continue_from(await self._form.read())
        self._lease.check_fresh()
        if self._left is not None and not differ(self._left, self._unanswered):
            self._unanswered = None
        return self._unanswered is not None

    async def _is_mine(self) -> bool:
        """Whether this gateway's last write is still in force; otherwise its next step would be a jump."""
        if self._left is None:
            return await self._is_begun()
        return self._agrees(await self._in_force(self._left), self._left)

    async def _is_begun(self) -> bool:
        """Before the first write of a ramp: whether two more readings say where it began, but for what a watchdog has
        taken away since; otherwise it begins anew, from there."""
        if self._form.together or self._begun_at is None:  # the control slews, from what is really in force
            return True
        at_s, before = self._begun_at
        found = [await self._form.read() for _ in range(_READINGS - 1)]
        self._lease.check_fresh()
        # The beat before it has stopped a watchdog; since long ago, only somebody else may have moved them.
        most_um = self._settings.slew_um_per_s * min(self._clock.monotonic() - at_s, _FADES * self._period)
        if not any(differ(reading, before, most_um) for reading in found):
            return True
        self._begin_at(found[-1])
        return False

    async def _put(self, coefficients: FloatArray) -> bool:
        """Whether the driver sends it. Offsets found at the start may exceed what the driver ever sends, and no ramp
        leads back from there."""
        self._left = None  # not known until it is read back
        sent_s = self._clock.monotonic()
        try:
            await self._form.write(coefficients)
        except NotSendable as error:
            offsets = offsets_text(coefficients)
            self._lease.disarm(Text(NoticeCode.NC_NOT_SENDABLE, error=failure(error), offsets=offsets))
            return False
        except (NoAnswer, ConnectError):
            now_s = self._clock.monotonic()
            self._unanswered, self._until_s = coefficients, now_s + _LATEST_S  # stays so if the driver cannot say
            self._until_s = now_s + min(max(self._late_write_s(), _LATE_S), _LATEST_S)
            raise
        answered_s = self._clock.monotonic()
        self._acted_s = sent_s if answered_s - sent_s < _WAITS * self._period else answered_s
        return True

    async def _read_back(self, coefficients: FloatArray) -> FloatArray:
        found = self._left = await self._in_force(coefficients)
        self._agrees(found, coefficients)
        return found

    async def _in_force(self, wanted: FloatArray) -> FloatArray:
        """What is in force, read once more where it is not `wanted`: one spoilt answer disarms nothing."""
        for _ in range(2):
            found = await self._form.read()
            self._lease.check_fresh()
            if not differ(found, wanted):
                break
        return found

    def _agrees(self, found: FloatArray, wanted: FloatArray) -> bool:
        """Disarm unless what was written is in force on the control. Compared where the difference is largest."""
        if not differ(found, wanted):
            return True
        if not self._is_late(found, wanted):
            self._lease.disarm(
                Text(NoticeCode.NC_OTHER_OFFSETS, wanted=offsets_text(wanted), found=offsets_text(found))
            )
        return False

    def _is_late(self, found: FloatArray, wanted: FloatArray) -> bool:
        """Whether this gateway's own unanswered write, or a part of it, is what is in force instead of `wanted`.

        If so, the next step continues from there.
        """
        late = self._unanswered
        if late is None or late.shape != found.shape:
            return False
        if differ(found, np.where(np.abs(found - late) < np.abs(found - wanted), late, wanted)):
            return False
        self._unanswered = None
        self._continue_from(found)
        self._lease.tell(Text(NoticeCode.NC_LATE_WRITE, found=offsets_text(found), wanted=offsets_text(wanted)))
        return True

    def _here(self, snapshot: NcSnapshot) -> FloatArray:
        return self._form.basis(positions(snapshot))

    def _record(
        self,
        step: Step,
        snapshot: NcSnapshot,
        k: int | None,
        *,
        written: bool = False,
        read_back: Offsets | None = None,
    ) -> None:
        before, self._last_step = self._last_step, step
        if step != before or (written and read_back is None):
            mode = self._settings.mode
            self._store(Write(snapshot.time, mode, step, k, snapshot.positions, written, read_back))
