"""The link to the NC: keeps the connection, reports its state, probes on request, writes what is safe."""

import asyncio
import logging
import math
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import AsyncExitStack
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from drivers.base import BadAnswer, ConnectError, DriverError, NoAnswer, Quality
from drivers.nc import NcSnapshot, NumericalControl, WatchdogTerms
from gateway.acquisition.breaker import Breaker
from gateway.acquisition.problems import Steadiness, Word
from gateway.clock import ServiceClock
from gateway.config import GatewayConfig
from gateway.nc.motion import Motion
from gateway.nc.routes import HeldOffsets, differ, form_of, positions, shown
from gateway.nc.slew import Offsets, Slew, Source, Step, Write, as_offsets
from gateway.nc.unmodelled import LastMeasured
from gateway.probing.cycle import Held, NotBegun, Outcome, Probe
from gateway.probing.prober import Prober
from gateway.probing.uninterrupted import to_its_end
from talc.frame import Decision, FloatArray, Why
from talc.names import THERMAL_ERRORS

log = logging.getLogger(__name__)

_LONGEST_RETRY_PERIODS = 30
_STEADY_S, _STEADY_PERIODS = 60.0, 10
"""What has not changed for so long, and so many periods, is steady."""
_SUBJECT = "NC"

States = Callable[[Mapping[str, float], float], None]
"""Takes machine states and the monotonic time they were read at."""
Notify = Callable[[str, bool], None]
"""Takes a problem's text, and whether it has ended."""


class NcLink:
    """One numerical control.

    Parameters
    ----------
    nc: the driver; nothing is opened before `run`
    config: sections nc, probing and compensation are used
    states: told of the machine states of every snapshot
    written: told of every step of the compensation
    notify: told of problems as they begin and end
    reference_mm: (poses, 3) centres that deviations are measured from; None: the first measurement sets them, from
        the mean of `probing.reference_cycles` cycles
    first_number: number of the first probing request; must differ from every earlier one
    abandoned: number of a request that an earlier run may have left behind: it is taken back
    owner: number of this gateway on the control, the same after every restart; 1 .. 2**31 - 1
    requested: told of every request's number before it is asked for
    measured: (9,) monotonic seconds of each error's last measurement, as an earlier run left it; None: now
    missing: inputs of live models without a good value, and the monotonic seconds since when, as an earlier run left it
    """

    def __init__(
        self,
        nc: NumericalControl,
        config: GatewayConfig,
        clock: ServiceClock,
        probe: Probe,
        *,
        states: States,
        written: Callable[[Write], None],
        notify: Notify,
        reference_mm: FloatArray | None,
        first_number: int,
        abandoned: int | None = None,
        owner: int = 1,
        requested: Callable[[int], None] = lambda _: None,
        measured: Sequence[float] | None = None,
        missing: Mapping[str, float] = MappingProxyType({}),
    ) -> None:
        if config.nc is None:
            raise ValueError("config has no [nc] section")
        self._nc, self._clock, self._probe = nc, clock, probe
        self._form = form_of(nc)
        self._period = config.nc.period_s
        self._probing, self._settings = config.probing, config.compensation
        self._states, self._written, self._notify = states, written, notify
        self._prober = Prober(nc, config.probing, clock, probe, reference_mm, first_number, abandoned, requested)
        self._writing = asyncio.Lock()
        self._breaker = Breaker(self._period, self._period * _LONGEST_RETRY_PERIODS)
        self._steadiness = Steadiness(max(_STEADY_S, _STEADY_PERIODS * self._period))
        self._connected = False
        self._disarmed = False
        self._owner = owner
        self._watched: bool | None = None
        self._beat_s = -math.inf
        settings = self._settings
        self._watch = WatchdogTerms(
            settings.watchdog_s, settings.slew_um_per_s if settings.when_stale == "zero" else 0.0
        )
        self._slew: Slew | None = None
        self._left: FloatArray | None = None
        self._motion = Motion(settings.frozen_after_s)
        self._frozen = False
        self._ready = True
        self._stopping = False
        self._missing = dict(missing)
        since = measured if measured is not None else [clock.monotonic()] * len(THERMAL_ERRORS)
        self._last_measured = LastMeasured(settings.measurement_stale_after_s, since)
        self._decision: tuple[Decision, float] | None = None
        self._last_step: Step | None = None
        self._attempted = False
        self.snapshot: NcSnapshot | None = None

    @property
    def armed(self) -> bool:
        """Whether offsets are written to the control."""
        return self._settings.mode == "compensate" and not self._disarmed

    @property
    def may_probe(self) -> bool:
        """Whether cycles may be asked for at all."""
        return self._probing.armed

    @property
    def present(self) -> NcSnapshot | None:
        """The control's latest state; None while it cannot be reached."""
        return self.snapshot if self._connected else None

    @property
    def missing_since(self) -> Mapping[str, float]:
        """Inputs of live models that have no good value, and the monotonic seconds since when."""
        return self._missing

    def follow(self, decision: Decision) -> None:
        """Compensate from this decision on."""
        now = self._clock.monotonic()
        self._decision = (decision, now)
        self._missing = {name: self._missing.get(name, now) for name in decision.substituted}

    async def run(self) -> None:
        """Read and write once per period until cancelled."""
        due = self._clock.monotonic()
        while True:
            await self._clock.sleep_until(due)
            with self._clock.hold():
                await to_its_end(self._cycle(due))
            late = max(0, math.ceil((self._clock.monotonic() - due) / self._period) - 1)
            due += self._period * (1 + late)

    async def stop(self) -> None:
        """Bring the compensation to its declared state, then let go of the control.

        Each part is tried, whatever became of the one before.
        """
        self._stopping = True
        async with AsyncExitStack() as stack:
            stack.push_async_callback(self._close)
            if self._connected:
                for part in (self._release, self._take_back, self._prober.withdraw):  # the last one first
                    stack.push_async_callback(self._try, part)

    async def _try(self, part: Callable[[], Awaitable[None]]) -> None:
        try:
            await part()
        except DriverError as error:
            log.warning("the NC could not be left as declared, its watchdog has it: %s", error)

    async def _take_back(self) -> None:
        if not self.armed or self._settings.when_stale != "zero":
            return
        if self._left is None or not self._ready:
            self._begin_from(await self._form.read())
        due = self._clock.monotonic()
        while self._slew is not None and self._slew.largest_um > 0 and not self._disarmed:
            due += self._period
            await self._clock.sleep_until(due)
            snapshot = self.snapshot = self._judged(await self._nc.snapshot())
            if not await self._alive():
                return  # the control's watchdog has it
            here, now = self._form.basis(positions(snapshot)[:3]), self._clock.monotonic()
            if snapshot.ready is False:
                await self._apply(self._slew.freeze(now, here, Source.NOT_READY), snapshot, send=False)
                return  # no offset is written now; it is the watchdog's, too
            await self._apply(self._slew.follow(now, None, Source.STOPPED, here), snapshot, send=True)

    async def _release(self) -> None:
        if self.armed:
            await self._nc.release(self._owner)

    async def measure(self, why: Why) -> Outcome:
        """One probing cycle, or those of the reference; see Prober. Offsets stand still until it has ended."""
        try:
            decision = None if self._decision is None else self._decision[0]
            outcome = await self._prober.measure(why, self._hold, decision)
        finally:
            self._frozen = False
        if outcome.measurement is not None:
            self._last_measured.measured(outcome.measurement, self._clock.monotonic())
        return outcome

    async def _hold(self) -> Held:
        async with self._writing:  # a write under way ends first, or what is read were not what stands
            self._frozen = True
            with self._clock.hold():
                held = HeldOffsets(self._form, self._clock, await to_its_end(self._form.read()))
        if self._disarmed and self._watch.ramp_um_per_s > 0 and held.any:
            raise NotBegun("compensation is disarmed and its offsets still go to zero")
        return held

    async def _cycle(self, due: float) -> None:
        if not self._connected and not await self._connect(due):
            return
        try:
            self.snapshot = self._judged(await self._nc.snapshot())
            if not self._frozen:
                await self._prober.settle()
            if self.snapshot.quality is Quality.GOOD:
                self._states(self.snapshot.states, self.snapshot.monotonic_s)
            await self._compensate(self.snapshot)
        except DriverError as error:
            await self._close()
            self._lost(error, due)
            return
        # Not as soon as it is connected: what is refused each time after that would be asked each period for ever.
        self._breaker.succeeded()
        if self._steadiness.well(_SUBJECT, self._clock.monotonic()):
            self._notify("NC: connected again", True)

    def _judged(self, snapshot: NcSnapshot) -> NcSnapshot:
        frozen = self._motion.frozen(snapshot)
        was = self.snapshot is not None and self.snapshot.quality is Quality.STALE
        if bool(frozen) is not was:
            axes = f"{', '.join(frozen)} report a speed and do not move" if frozen else "the axes move again"
            self._notify(f"NC: {axes}", not frozen)
        return replace(snapshot, quality=Quality.STALE) if frozen else snapshot

    async def _connect(self, due: float) -> bool:
        if not self._breaker.allows(due):
            return False
        try:
            await self._nc.connect()
            if self.armed:
                await self._nc.claim(self._owner, self._watch)
            self._begin_from(await self._form.read())
        except DriverError as error:
            await self._close()
            self._lost(error, due)
            return False
        self._connected = True
        return True

    def _begin_from(self, in_force: FloatArray) -> None:
        """Whatever stands on the control is where the ramp begins: no step at start and none after a reconnect.

        Raises BadAnswer for what is no number: nothing could begin there.
        """
        if not np.all(np.isfinite(in_force)):
            raise BadAnswer(f"offsets {shown(in_force)} µm are in force: expected finite numbers", device="nc")
        self._slew = Slew(
            self._settings.bound_um,
            self._settings.slew_um_per_s,
            self._settings.when_stale,
            self._period,
            in_force,
            self._clock.monotonic(),
        )
        self._left = None

    async def _alive(self) -> bool:
        """Beat. Whether offsets may be written: the control's watchdog watches, and nothing moved since it did not."""
        began = self._clock.monotonic()
        watched = await self._nc.heartbeat(self._owner)
        self._beat_s = began  # not now: this process may have stood still since the control heard it
        if not watched:
            # It may have moved the offsets. This beat stops it, so what is read now is where to go on.
            self._begin_from(await self._form.read())
        if watched is not self._watched and self._watched is not None:
            self._notify(f"NC: its watchdog {'watches again' if watched else 'did not hear this gateway'}", watched)
        self._watched = watched
        return watched

    def _lost(self, error: DriverError, due: float) -> None:
        self._connected, self.snapshot = False, None
        self._breaker.failed(due)
        # Whether the line is cut or silent, it is the same trouble.
        kind = "line" if isinstance(error, ConnectError | NoAnswer) else type(error).__name__
        word = self._steadiness.bad(_SUBJECT, kind, self._clock.monotonic())
        if word is not Word.NOTHING:
            text = f"NC: {error}"
            if word is Word.LAST:
                text += f"; it comes and goes: told again when it has been steady for {self._steadiness.window_s:g} s"
            log.warning("%s", text)
            self._notify(text, False)

    async def _compensate(self, snapshot: NcSnapshot) -> None:
        if self._slew is None:
            return
        may_write = self.armed and await self._alive()
        now = self._clock.monotonic()
        here = self._form.basis(positions(snapshot)[:3])
        async with self._writing:
            if snapshot.ready is not False and not self._ready:
                self._begin_from(await self._form.read())  # it may have been switched off meanwhile
            self._ready = snapshot.ready is not False
            # A cycle that nobody waits for any more, or another's, may be touching the sphere at this moment.
            if self._frozen or snapshot.probing or not self._ready:
                step = self._slew.freeze(now, here, Source.FROZEN if self._ready else Source.NOT_READY)
                await self._apply(step, snapshot, send=False)
            else:
                step = self._slew.follow(now, *self._wanted(snapshot, now), here)
                await self._apply(step, snapshot, send=may_write)

    async def _apply(self, step: Step, snapshot: NcSnapshot, *, send: bool) -> None:
        """Send a step if it is to be sent; tell of it also when the control does not answer."""
        self._attempted, read_back = False, None
        try:
            if send:
                read_back = await self._send(step, self._form.basis(positions(snapshot)[:3]))
        finally:
            if step != self._last_step or (self._attempted and read_back is None):
                k = self._decision[0].k if self._decision else None
                mode, at = self._settings.mode, snapshot.positions
                self._tell(Write(snapshot.time, mode, step, k, at, self._attempted, read_back))
            self._last_step = step

    def _tell(self, write: Write) -> None:
        try:
            self._written(write)
        except Exception:
            if not self._stopping:
                raise
            # A full disk ends the gateway; it shall not leave the offsets where they are.
            log.exception("a step of the compensation was not stored while stopping")

    def _wanted(self, snapshot: NcSnapshot, now: float) -> tuple[FloatArray | None, Source]:
        if self._decision is None:
            return None, Source.NO_MODEL
        decision, decided = self._decision
        if now - decided > self._settings.stale_after_s or snapshot.quality is not Quality.GOOD:
            return None, Source.STALE
        if any(now - since > self._settings.inputs_stale_after_s for since in self._missing.values()):
            return None, Source.INPUTS_STALE
        corrected = decision.corrected
        if self._settings.when_stale == "zero":
            corrected = self._last_measured.corrected(decision, now)
        if not np.any(np.isfinite(corrected)):
            return None, Source.NO_MODEL
        # An error without an estimate is not compensated; the others still are.
        known = np.nan_to_num(corrected)
        return self._form.wanted(known, positions(snapshot), self._probe.radius_m), Source.PREDICTION

    async def _send(self, step: Step, here: FloatArray | None = None) -> Offsets | None:
        """What is in force after the write; None: nothing was written."""
        wanted = np.array(step.coefficients_um)
        self._check_beat()
        if self._left is not None:
            # Our next step would be a jump from where somebody else has put it.
            found = await self._form.read()
            self._check_beat()
            if self._differ(found, self._left):
                return None
        self._attempted = True
        self._left = None  # not known until it is read back
        try:
            await self._form.write(wanted)
        except ValueError as error:
            # What stood there at the start lies beyond what the driver ever sends: no ramp leads out of it.
            self._attempted = False
            self._disarm(f"NC: {error}; {shown(wanted)} µm were to be sent; compensation is disarmed until a restart")
            return None
        found = self._left = await self._form.read()
        self._check_beat()
        self._differ(found, wanted)
        return as_offsets(found[:, 0] if here is None else found @ here)

    def _check_beat(self) -> None:
        """Raises NoAnswer when this process has stood still since its beat: the control may have moved the offsets."""
        if self._clock.monotonic() - self._beat_s > self._watch.silence_s / 2:
            raise NoAnswer(f"more than {self._watch.silence_s / 2:g} s since the heartbeat", device="nc")

    def _differ(self, found: FloatArray, wanted: FloatArray) -> bool:
        """Disarm unless the control has in force what was written. Compared where the difference is largest."""
        differs = differ(found, wanted)
        if differs:
            self._disarm(
                f"NC: wrote offsets {shown(wanted)} µm but {shown(found)} are in force; compensation is disarmed "
                "until a restart. Does something else write there?"
            )
        return differs

    def _disarm(self, text: str) -> None:
        """Neither writes nor beats from now on: the control's watchdog brings the offsets to their declared state."""
        self._disarmed = True
        log.warning("%s", text)
        self._notify(text, False)

    async def _close(self) -> None:
        self._connected = False
        try:
            await self._nc.close()
        except DriverError as error:
            log.debug("closing the NC: %s", error)
