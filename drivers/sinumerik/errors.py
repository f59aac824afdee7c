"""SINUMERIK with a program that computes the offsets from the nine errors: drivers.sinumerik.programs."""

import math
from dataclasses import replace
from typing import Final

from drivers.base import BadAnswer, Clock, Refused
from drivers.nc import (
    ERRORS,
    NineErrors,
    NotSendable,
    ProbingState,
    RequestStatus,
    Triple,
    WatchdogTerms,
    check_errors,
    check_offsets,
)
from drivers.sinumerik.control import Sinumerik
from drivers.sinumerik.lease import ALIVE
from drivers.sinumerik.programs import ER0T, EX0C, EY0A, EZ0A, PROGRAM_VERSION, ErrorTerms
from drivers.sinumerik.settings import ERROR_TERMS, SinumerikSettings
from drivers.text import Text

_SAME: Final = 1e-6
_AGAIN: Final = Text("nc_errors_again")


class SinumerikWithErrors(Sinumerik):
    """One control with route `errors`. Implements FollowsErrors; errors like Sinumerik's.

    A control without the program takes shifts, like route `k0`. What it reports of the nine is what it slews to: the
    program is behind by one period at most, and what stood still while it probed is reported with the result.
    """

    def __init__(self, settings: SinumerikSettings, clock: Clock) -> None:
        super().__init__(settings, clock)
        numbers, r = settings.errors, settings.r
        self._wanted = tuple(r(numbers.wanted + i) for i in range(ERRORS))
        self._probed = tuple(r(numbers.probed + i) for i in range(3))
        self._version = (r(numbers.version),)
        self._echo_of_shifts, self._echo_of_errors = self._lease.echo, r(numbers.echo)
        self._moving = (r(settings.lease.state), *(r(numbers.in_force + i) for i in range(ERRORS)))
        self._tool, self._tool_range = (r(numbers.tool),), (r(numbers.tool_range),)
        self._terms_told = tuple(r(numbers.terms + i) for i in range(ERROR_TERMS))
        self._terms: ErrorTerms | None = None
        self._reach: tuple[float, float] | None = None

    @property
    def error_reach_mm(self) -> tuple[float, float] | None:
        return self._reach

    @property
    def slopes(self) -> None:
        """None: without the program it takes only shifts."""

    async def connect(self) -> None:
        """Also finds out whether the program is there. Raises BadAnswer for another version or invalid terms of it."""
        self._terms = self._reach = None
        self._lease.echo = self._echo_of_shifts
        await super().connect()
        try:
            [version] = self._numbers(self._version, await self._session.read(self._version))
            if version:
                await self._look_at_program(version)
            elif self._settings.compensation.synchronised:
                raise Refused(
                    Text("nc_no_errors_gantry"),
                    device=self._device,
                    hint=_AGAIN,
                )
        except BaseException:
            await self.close()
            raise

    async def _look_at_program(self, version: float) -> None:
        if version != PROGRAM_VERSION:
            raise BadAnswer(
                Text("nc_errors_version", version=version, wanted=PROGRAM_VERSION), device=self._device, hint=_AGAIN
            )
        await self._session.read((*self._wanted, *self._probed, self._echo_of_errors, *self._moving, *self._tool))
        slew, radius, x, y, z, *reach = self._numbers(self._terms_told, await self._session.read(self._terms_told))
        if min(slew, radius, x, y, z, *reach) <= 0:
            raise BadAnswer(Text("nc_errors_term"), device=self._device, hint=_AGAIN)
        await self._check_tool_range()
        self._terms, self._reach = ErrorTerms(slew, radius, (x, y, z)), (reach[0], reach[1])
        self._lease.echo = self._echo_of_errors

    async def _check_tool_range(self) -> None:
        """Its sign says who reads the length of the tool."""
        wanted = self._settings.tool_range_mm * (-1.0 if self._settings.reads_its_tool else 1.0)
        [found] = self._numbers(self._tool_range, await self._session.read(self._tool_range))
        if not math.isclose(found, wanted, rel_tol=_SAME):
            raise Refused(
                Text("nc_errors_tool", found=found, wanted=wanted),
                device=self._device,
                hint=_AGAIN,
            )

    async def claim(self, owner: int, terms: WatchdogTerms, predecessor: int | None = None) -> None:
        """Like Sinumerik's. Raises Refused if the program slews at another rate than the one that is declared."""
        slew, declared = None if self._terms is None else self._terms.slew_um_per_s, terms.slew_um_per_s
        if slew is not None and declared is not None and not math.isclose(slew, declared, rel_tol=_SAME):
            raise Refused(
                Text("nc_errors_slew", slew=slew, declared=declared),
                device=self._device,
                hint=_AGAIN,
            )
        await super().claim(owner, terms, predecessor)

    async def heartbeat(self, owner: int) -> bool:
        """Like Sinumerik's. Raises BadAnswer if no beat passes through because no tool is as long as it reads."""
        heard = await super().heartbeat(owner)
        if not heard and self._terms is not None and self._settings.reads_its_tool:
            await self._look_at_tool_in_use()
        return heard

    async def _look_at_tool_in_use(self) -> None:
        [longer] = self._numbers(self._tool, await self._session.read(self._tool))
        most, origin = self._settings.tool_range_mm, self._settings.origin_tool_mm or 0.0
        if not abs(longer) <= most:
            raise BadAnswer(
                Text("nc_tool_long", node=self._tool[0], length=longer + origin, longer=longer, most_mm=most),
                device=self._device,
                hint=Text("nc_correct_origin"),
            )
        self._tool_mm = longer

    async def write_errors(self, errors: NineErrors) -> None:
        """Raises NotSendable, before anything is sent, for numbers that are not finite or beyond `largest_um`, and for
        another radius or bound than the program's."""
        check_errors(errors, self._settings.compensation.largest_um)
        terms = self._known()
        mine, theirs = (terms.radius_mm, *terms.bound_um), (errors.radius_mm, *errors.bound_um)
        if not all(math.isclose(a, b, rel_tol=_SAME) for a, b in zip(mine, theirs, strict=True)):
            raise NotSendable(Text("nc_errors_bounds", mine=str(mine), theirs=str(theirs), hint=_AGAIN))
        await self._put(errors.errors)

    async def read_errors(self, radius_mm: float) -> tuple[float, ...]:
        known = self._known().radius_mm
        if self._settings.reads_its_tool:
            await self._look_at_tool_in_use()
        values = self._numbers(self._wanted, await self._session.read(self._wanted))
        values[ER0T] *= radius_mm / known
        return tuple(values)

    async def write_compensation(self, offsets_um: Triple) -> None:
        """The same shift at every position of the axes."""
        if self._terms is None:
            await super().write_compensation(offsets_um)
            return
        check_offsets(offsets_um, self._settings.compensation.largest_um)
        errors = [0.0] * ERRORS
        errors[EX0C], errors[EY0A], errors[EZ0A] = offsets_um
        await self._put(errors)

    async def request_probing(self, number: int, dry_run_mm: float = 0.0) -> None:
        """Raises Refused also while errors are in force that no gateway keeps alive: the program then holds nothing,
        and the offsets would change from pose to pose."""
        if self._terms is not None:
            state, *in_force = self._numbers(self._moving, await self._session.read(self._moving))
            if state != ALIVE and max(map(abs, in_force)) > _SAME:
                raise Refused(
                    Text("nc_errors_in_force"),
                    device=self._device,
                    hint=Text("nc_wait_watchdog"),
                )
        await super().request_probing(number, dry_run_mm)

    async def probing_status(self, number: int) -> RequestStatus:
        status = await super().probing_status(number)
        if status.state is not ProbingState.DONE or self._terms is None:
            return status
        x, y, z = (v * 1e3 for v in self._numbers(self._probed, await self._session.read(self._probed)))
        return replace(status, in_force_um=(x, y, z))

    @property
    def _writable(self) -> tuple[tuple[str, ...], ...]:
        return super()._writable if self._terms is None else (*super()._writable[:-1], self._wanted)

    async def _put(self, errors: tuple[float, ...] | list[float]) -> None:
        wanted = dict(zip(self._wanted, errors, strict=True))
        if not self._settings.reads_its_tool:
            wanted[self._tool[0]] = self._tool_mm
        await self._session.write(wanted)

    def _known(self) -> ErrorTerms:
        if self._terms is None:
            raise Refused(Text("nc_no_errors"), device=self._device, hint=_AGAIN)
        return self._terms

    @property
    def _device(self) -> str:
        return self._settings.device
