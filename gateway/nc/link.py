"""The link to the NC: keeps the connection, reports its state, probes on request, writes what is safe.

It consists of a session (connection), a lease (right to write), a target (what is wanted), a writer (steps, read back),
a hold (offsets stand still while the control probes) and a prober. gateway.nc.states defines how they work together.
"""

import logging
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import AsyncExitStack
from typing import assert_never

import numpy as np

from drivers.base import DriverError, Quality
from drivers.nc import FollowsErrors, ForgetsWrites, MarksPath, NcSnapshot, NumericalControl, RunsDry
from gateway.model.codes import NoticeCode
from gateway.model.commands import Disarmed, Pause
from gateway.model.compensation import Source, Write
from gateway.model.probing import Outcome
from gateway.model.text import Text, text_of
from gateway.nc.boundary import contained_control
from gateway.nc.hold import Hold
from gateway.nc.lease import Lease
from gateway.nc.pace import NcPace
from gateway.nc.probing.cycle import Held, NotBegun, probe_of
from gateway.nc.probing.foreign import CycleWatch
from gateway.nc.probing.geometry import barrier
from gateway.nc.probing.prober import Prober
from gateway.nc.probing.uninterrupted import to_its_end
from gateway.nc.routes import form_of, positions
from gateway.nc.session import Session
from gateway.nc.settings import Earlier, LinkSettings, Listeners
from gateway.nc.states import STATES, Condition, LinkState, after
from gateway.nc.target import Target
from gateway.nc.unmodelled import LastMeasured
from gateway.nc.writer import OffsetWriter
from gateway.runtime.clocks import ServiceClock
from gateway.runtime.periodic import Periodic
from gateway.runtime.problems import Problems
from talc.frame import Decision, FloatArray, Why
from talc.names import THERMAL_ERRORS

log = logging.getLogger(__name__)

_FORM = "form of NC"
_CYCLE = "cycle of NC"


class NcLink:
    """One numerical control.

    Parameters
    ----------
    nc: the driver; nothing is opened before `run`
    settings: how it is read, written and probed
    earlier: what an earlier run left
    listeners: what it calls
    stored: whether what it does can be stored; if not, the offsets go to their declared state
    """

    def __init__(
        self,
        nc: NumericalControl,
        clock: ServiceClock,
        settings: LinkSettings,
        earlier: Earlier,
        listeners: Listeners,
        stored: Callable[[], bool] = lambda: True,
    ) -> None:
        self._clock, self._listeners = clock, listeners
        self._period, self._probing, compensation = settings.period_s, settings.probing, settings.compensation
        self._when_stale = compensation.when_stale
        self._state = LinkState.AWAY
        nc = contained_control(nc)
        self._follows = nc if isinstance(nc, FollowsErrors) else None
        self._probe = probe_of(settings.probing)
        self._form = form_of(nc, self._probe.radius_m, compensation.bound_um)
        self._problems = Problems(clock, settings.period_s, listeners.notify, log)
        self._session = Session(
            nc,
            period_s=settings.period_s,
            frozen_after_s=compensation.frozen_after_s,
            problems=self._problems,
        )
        self._pace = NcPace(settings.period_s, self._problems)
        self._lease = Lease(nc, clock, settings.identity, compensation, self._problems, listeners.notify)
        self._writer = OffsetWriter(
            self._form,
            self._lease,
            clock,
            compensation,
            settings.period_s,
            lambda: nc.late_write_s if isinstance(nc, ForgetsWrites) else 0.0,
            self._store,
        )
        self._hold = Hold(self._form, clock)
        self._nc, self._proven, self._paths = nc, earlier.proven, earlier.paths
        self._same_path = True
        self._runs_dry: bool | None = None
        self._probes_since_s: float | None = None
        """Since when the control has reported a cycle that this gateway does not wait for."""
        self._prober = Prober(
            nc,
            settings.probing,
            clock,
            self._probe,
            earlier.reference_mm,
            earlier.first_number,
            earlier.abandoned,
            self._permit,
            CycleWatch(settings.path),
        )
        measured = earlier.measured_s if earlier.measured_s is not None else [clock.monotonic()] * len(THERMAL_ERRORS)
        self._target = Target(
            compensation,
            LastMeasured(compensation.measurement_stale_after_s, measured),
            earlier.missing_s,
            stored,
            earlier.paused,
            earlier.disarmed,
        )

    @property
    def armed(self) -> bool:
        """Whether offsets are written to the control."""
        return self._lease.armed

    @property
    def may_probe(self) -> bool:
        """Whether cycles may be requested at all."""
        return self._probing.armed and self.disarmed is None

    @property
    def barrier(self) -> Text:
        """Why no cycle may be requested before a dry run; empty: nothing stands against it."""
        return barrier(self._probing, proven=self._proven, runs_dry=self._runs_dry, same_path=self._same_path)

    @property
    def tried(self) -> bool:
        """Whether the first attempt to reach the control has succeeded or failed; before, `present` tells nothing."""
        return self._session.tried

    @property
    def present(self) -> NcSnapshot | None:
        """The control's latest state; None while it cannot be reached."""
        return self._session.latest

    @property
    def paused(self) -> Pause | None:
        """The compensation's pause; None: it is not paused."""
        return self._target.paused

    def pause(self, pause: Pause | None) -> None:
        """From the next step on the offsets go to their declared state; None: they follow the decisions again."""
        self._target.paused = pause

    @property
    def disarmed(self) -> Disarmed | None:
        """Who has disarmed the gateway; None: nobody."""
        return self._target.disarmed

    def disarm(self, order: Disarmed | None) -> None:
        """From the next step on the offsets go to zero, no cycle is requested, and one that waits is withdrawn; None:
        as the configuration says again."""
        self._target.disarmed = order

    def follow(self, decision: Decision) -> None:
        """Compensate by this decision from now on."""
        self._target.follow(decision, self._clock.monotonic())

    def renew(self, corrected: FloatArray) -> None:
        """Compensate by these (9,) errors until the next decision, or until they are renewed again."""
        self._target.renew(corrected)

    def remembered(self, measured_s: Sequence[float], missing_s: Mapping[str, float]) -> None:
        """The times of `Earlier`, now that the clock is known to be right; those of this run stay."""
        self._target.remembered(measured_s, missing_s)

    def drop_reference(self, reason: Text) -> Outcome | None:
        """The next measurement sets another reference; see Prober."""
        return self._prober.drop_reference(reason)

    async def measure(self, why: Why) -> Outcome:
        """One probing cycle, or those of the reference; see Prober. The offsets stand still until it has ended."""
        try:
            outcome = await self._prober.measure(why, self._held, self._target.decision)
        finally:
            self._hold.end()
        if outcome.measurement is not None:
            self._target.measured(outcome.measurement, self._clock.monotonic())
        return outcome

    async def run(self) -> None:
        """Read and write once per period until cancelled."""
        await Periodic(self._clock, self._period).run(lambda due_s: to_its_end(self._cycle(due_s)), self._worked)

    def _worked(self, skipped: int) -> None:
        if self._session.latest is not None:  # otherwise it is the connection that takes its time
            self._pace.worked(skipped)

    async def stop(self) -> None:
        """Bring the compensation to its configured state, then release the control.

        Each part is tried, whatever happened to the one before.
        """
        self._state = after(STATES, self._state, Condition.STOP)
        async with AsyncExitStack() as stack:
            stack.push_async_callback(self._session.close)
            if self._state is LinkState.STOPPING:
                for part in (self._lease.release, self._take_back, self._prober.withdraw):  # the last one runs first
                    stack.push_async_callback(self._try, part)

    async def disconnect(self) -> None:
        """Close the connection and nothing else, as if the gateway had been killed: the watchdog takes over the
        offsets."""
        await self._session.close()

    # One period ------------------------------------------------------------------------------------------------------

    async def _cycle(self, due_s: float) -> None:
        if self._state is LinkState.AWAY and not self._session.may_connect(due_s):
            return
        try:
            if self._state is LinkState.AWAY:
                await self._session.connect()
                self._same_path = self._is_proven_path()
                await self._lease.claim()
                await self._writer.begin()
                self._state = after(STATES, self._state, Condition.CONNECTED)
            self._tell_form()
            snapshot = await self._session.look()
            self._runs_dry = isinstance(self._nc, RunsDry) and self._nc.runs_dry
            if not self._hold.on or self.disarmed is not None:
                await self._prober.settle()
            await self._prober.look(snapshot)
            self._tell_cycle(snapshot)
            if snapshot.quality is Quality.GOOD:
                self._listeners.states(snapshot.states, snapshot.monotonic_s)
            await self._compensate(snapshot)
        except DriverError as error:
            self._state = after(STATES, self._state, Condition.LOST)
            self._lease.lost()
            latest = self._session.latest
            await self._session.lost(error, due_s)
            if latest is not None and self._lease.armed:
                self._writer.lost(latest, self._k)
            return
        self._session.works()

    def _is_proven_path(self) -> bool:
        path = self._nc.path_mark if isinstance(self._nc, MarksPath) else ""
        return not path or self._paths is None or path in self._paths

    async def _compensate(self, snapshot: NcSnapshot) -> None:
        may_write = self._lease.armed and await self._beat()
        now = self._clock.monotonic()
        async with self._hold.writing:
            k = self._k
            before, self._state = self._state, after(STATES, self._state, self._finding(snapshot))
            if before is LinkState.NOT_READY and self._state is not LinkState.NOT_READY:
                await self._writer.begin()  # it may have been switched off meanwhile
            match self._state:
                case LinkState.FOLLOWING:
                    errors, source = self._target.errors(snapshot.quality, now)
                    at, radius_m = positions(snapshot), self._probe.radius_m
                    wanted = None if errors is None else self._form.wanted(errors, at, radius_m)
                    if self._lease.armed and not may_write:
                        # What is not sent is no base for the next step: both together would be more than a period's.
                        self._writer.stand(now, snapshot, source, k)
                    else:
                        await self._writer.follow(now, snapshot, wanted, source, k, send=may_write)
                case LinkState.HELD:
                    self._writer.stand(now, snapshot, Source.FROZEN, k)
                case LinkState.NOT_READY:
                    self._writer.stand(now, snapshot, Source.NOT_READY, k)
                    self._writer.forget()
                case LinkState.AWAY | LinkState.STOPPING:
                    pass  # no period runs then
                case _:
                    assert_never(self._state)

    def _finding(self, snapshot: NcSnapshot) -> Condition:
        if snapshot.ready is False:
            return Condition.NOT_READY
        # A cycle that no one waits for any more, or another gateway's, may be touching the sphere at this moment.
        return Condition.PROBING if self._hold.on or snapshot.probing else Condition.CLEAR

    def _tell_form(self) -> None:
        """A control that could follow the nine errors by itself, and whose program for it is missing."""
        nc = self._follows
        if nc is None or not self._lease.armed:
            return
        if nc.error_reach_mm is None and nc.slopes is None:
            self._problems.report(_FORM, Text(NoticeCode.NC_ONE_SHIFT))
        else:
            self._problems.clear(_FORM, NoticeCode.NC_FOLLOWS_AGAIN)

    def _tell_cycle(self, snapshot: NcSnapshot) -> None:
        """A control that does not say any more when a cycle is over keeps the offsets where they are."""
        if not snapshot.probing:
            self._probes_since_s = None
            self._problems.clear(_CYCLE, NoticeCode.NC_PROBES_NO_MORE)
            return
        if self._hold.on:
            return
        now_s = self._clock.monotonic()
        if self._probes_since_s is None:
            self._probes_since_s = now_s
        if now_s - self._probes_since_s > self._probing.timeout_s:
            minutes = self._probing.timeout_s / 60
            self._problems.report(_CYCLE, Text(NoticeCode.NC_PROBES_ON, minutes=minutes))

    async def _beat(self) -> bool:
        """Whether offsets may be written."""
        heard = await self._lease.beat()
        if not heard:
            # The watchdog may have moved the offsets. This beat stops it, so continue from what is read now.
            self._hold.unheard()
            await self._writer.begin()
        return heard

    @property
    def _k(self) -> int | None:
        return None if self._target.decision is None else self._target.decision.k

    async def _held(self) -> Held:
        held = await self._hold.begin()
        if self._lease.taken_back and held.any:
            raise NotBegun(Text(NoticeCode.OFFSETS_STILL_RAMPING))
        return held

    async def _permit(self, number: int) -> None:
        """Before each request. Raises NotBegun."""
        if self._listeners.requested is not None:
            await self._listeners.requested(number)
        if self.disarmed is not None:
            raise NotBegun(Text(NoticeCode.GATEWAY_IS, order=self.disarmed.text))
        if self.barrier:
            raise NotBegun(self.barrier)

    def _store(self, write: Write) -> None:
        try:
            self._listeners.written(write)
        except Exception:
            if self._state is not LinkState.STOPPING:
                raise
            # Whatever ended the gateway must not leave the offsets where they are.
            log.exception("a step of the compensation was not stored while stopping")

    # The end ---------------------------------------------------------------------------------------------------------

    async def _take_back(self) -> None:
        if not self.armed or (self._when_stale != "zero" and self.disarmed is None):
            return
        if not self._writer.knows:
            await self._writer.begin()
        due = self._clock.monotonic()
        while self._lease.armed and self._writer.largest_um > 0:
            due += self._period
            await self._clock.sleep_until(due)
            snapshot = await self._session.look()
            if not await self._beat():
                return  # the control's watchdog takes over
            now = self._clock.monotonic()
            if snapshot.ready is False:
                self._writer.stand(now, snapshot, Source.NOT_READY, self._k)
                return  # no offset can be written now: leave this to the watchdog too
            zero = self._form.wanted(np.zeros(len(THERMAL_ERRORS)), positions(snapshot), self._probe.radius_m)
            await self._writer.follow(now, snapshot, zero, Source.STOPPED, self._k, send=True)

    async def _try(self, part: Callable[[], Awaitable[None]]) -> None:
        try:
            await part()
        except DriverError as error:
            log.warning("%s", Text(NoticeCode.NC_NOT_LEFT, error=text_of(error)))
