"""Runs probing cycles on one control, and returns a measurement from their results or the reason why there is none."""

import logging
import math
from collections.abc import Awaitable, Callable

import numpy as np

from drivers.base import DriverError, Refused
from drivers.nc import NcSnapshot, NumericalControl, Triple
from gateway.config.sections import Probing
from gateway.model.codes import NoticeCode
from gateway.model.probing import End, InForce, Outcome
from gateway.model.text import NOTHING, Text, failure, text_of
from gateway.nc.probing.checks import Expected, MeasurementChecks
from gateway.nc.probing.cycle import Held, NotBegun, Probe, Rejected, at_rest, centres, run_cycle
from gateway.nc.probing.foreign import CycleWatch
from gateway.runtime.clocks import ServiceClock
from talc.frame import Decision, FloatArray, Measurement, Why

log = logging.getLogger(__name__)

_RECENT_S = 3600.0
"""A last measurement younger than this substitutes for a missing prediction."""


class Prober:
    """Requests cycles and checks their results.

    Parameters
    ----------
    settings: the [probing] section
    reference_mm: (poses, 3) centres that deviations are measured from; None: the first measurement sets them, from
        the mean of `reference_cycles` cycles
    first_number: number of the first request; must differ from every earlier one
    abandoned: number of a request that an earlier run may have left behind
    requested: awaited with every number before it is sent; raises NotBegun if it cannot be stored
    watch: judges the snapshots that `look` gets
    """

    def __init__(
        self,
        nc: NumericalControl,
        settings: Probing,
        clock: ServiceClock,
        probe: Probe,
        reference_mm: FloatArray | None,
        first_number: int,
        abandoned: int | None = None,
        requested: Callable[[int], Awaitable[None]] | None = None,
        watch: CycleWatch | None = None,
    ) -> None:
        self._nc, self._settings, self._clock, self._probe = nc, settings, clock, probe
        self._checks = MeasurementChecks(settings, probe.radius_m)
        self._reference, self._number = reference_mm, first_number
        self._dropped = 0
        """How often the reference was dropped."""
        self._last: tuple[Measurement, float] | None = None
        self._requested, self._watch = requested, watch or CycleWatch()
        self._waiting_for = abandoned if settings.armed else None

    async def measure(self, why: Why, hold: Callable[[], Awaitable[Held]], decision: Decision | None) -> Outcome:
        """One cycle, or those of the reference. Never raises for what the control does: the outcome says why there is
        no result.

        hold: makes the offsets stand still, or raises NotBegun; decision: the latest, None before the first
        """
        asked = self._clock.utc()
        in_force: InForce = (0.0, 0.0, 0.0)
        found: FloatArray | None = None
        measurement: Measurement | None = None
        residual, reason, end = math.nan, NOTHING, End.MEASURED
        dropped, expected = self._dropped, self._expected(decision)
        if why is Why.REFERENCE:  # errors are zero from now on, whatever was expected of them
            expected = Expected(*np.full((3, 9), np.nan))
        try:
            held = await hold()
            in_force = held.at(None)
            # Noise of the reference would stay in every later measurement, so it is a mean of several cycles.
            count = self._settings.reference_cycles if self._reference is None else 1
            results = [await self._probed() for _ in range(count)]
            cycles = [cycle for cycle, _ in results]
            found = np.mean(cycles, axis=0)
            in_force = _in_force([shift for _, shift in results]) or held.at(found)
            await held.still()
            if self._dropped != dropped:
                raise Rejected(Text(NoticeCode.CYCLE_OF_FORMER_REFERENCE))
            at_rest(cycles, self._settings.max_repeat_um)
            if self._reference is None:
                self._reference = found + np.asarray(in_force) * 1e-3
            result = self._probe.solve(self._probe.deviations_um(found, self._reference, in_force))
            residual = result.residual_rms
            self._checks.fits(result)
            candidate = Measurement(result.errors, result.sigma)
            self._checks.plausible(candidate, expected)
            measurement = candidate
            self._last = candidate, self._clock.monotonic()
        except Rejected as error:
            reason, end = error.text, End.REJECTED
        except NotBegun as error:
            reason, end = error.text, End.REFUSED
        except DriverError as error:
            reason, end = Text(NoticeCode.NC_NOT_ASKED, error=failure(error)), End.REFUSED
        return Outcome(
            self._number - 1, why, asked, self._clock.utc(), found, in_force, measurement, residual, reason, end
        )

    def drop_reference(self, reason: Text) -> Outcome | None:
        """The next measurement sets another reference; one that runs is no result any more.

        Returns the outcome that says so, a new reference without a result; None: there is no reference.
        """
        if self._reference is None:
            return None
        self._reference, self._last, self._dropped = None, None, self._dropped + 1
        self._checks = MeasurementChecks(self._settings, self._probe.radius_m)
        now = self._clock.utc()
        return Outcome(
            self._number - 1, Why.REFERENCE, now, now, None, (0.0, 0.0, 0.0), None, math.nan, reason, End.REJECTED
        )

    async def withdraw(self) -> None:
        """Withdraw a request that is no longer wanted. Raises DriverError."""
        number = self._waiting_for
        if number is not None:
            await self._nc.withdraw_probing(number)
            if self._waiting_for == number:
                self._waiting_for = None

    async def settle(self) -> None:
        """While no measurement runs: withdraw what a lost connection or an earlier run left behind. Raises DriverError,
        but not for what the control refuses."""
        try:
            await self.withdraw()
        except Refused as error:
            log.warning("%s", Text(NoticeCode.REQUEST_NOT_WITHDRAWN, number=self._waiting_for, error=text_of(error)))
            self._waiting_for = None

    async def _probed(self) -> tuple[FloatArray, Triple | None]:
        """Centres, and the shift that the control says was in force."""
        await self.settle()
        number = self._number
        self._number += 1
        if self._requested is not None:
            await self._requested(number)  # a number that was not stored would be used again
        self._waiting_for = number
        self._watch.begin()
        try:
            status = await run_cycle(
                self._nc,
                number,
                self._clock,
                poll_s=self._settings.poll_s,
                timeout_s=self._settings.timeout_s,
                told=self._watch.told,
            )
        except (NotBegun, Rejected) as error:
            self._waiting_for = None
            self._check_watch(error)
            raise
        self._waiting_for = None
        self._check_watch()
        found = centres(status, len(self._probe.poses_rad))
        self._checks.repeats(None if status.spread_mm is None else status.spread_mm * 1e3)
        return found, status.in_force_um

    async def look(self, snapshot: NcSnapshot) -> None:
        """A snapshot while a cycle may run: one that shows what it did not command ends it. Raises DriverError."""
        if self._watch.look(snapshot):
            await self.settle()

    def _check_watch(self, error: Exception | None = None) -> None:
        """Raises Rejected if anything happened that the cycle did not command."""
        if self._watch.found:
            raise Rejected(Text(NoticeCode.CYCLE_VOID, text=self._watch.found)) from error

    def _expected(self, decision: Decision | None) -> Expected:
        nothing = np.full(9, np.nan)
        last = nothing
        if self._last is not None and self._clock.monotonic() - self._last[1] <= _RECENT_S:
            last = self._last[0].errors
        if decision is None:
            return Expected(last, nothing, nothing)
        modelled = np.isfinite(decision.sigma)
        return Expected(np.where(modelled, decision.corrected, last), decision.sigma, decision.limits)


def _in_force(shifts: list[Triple | None]) -> Triple | None:
    """The mean of the cycles; None when the control did not report it."""
    told = [shift for shift in shifts if shift is not None]
    if len(told) < len(shifts):
        return None
    x, y, z = (sum(axis) / len(told) for axis in zip(*told, strict=True))
    return x, y, z
