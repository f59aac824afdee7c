"""LinuxCNC through its agent (deploy/nc/linuxcnc): snapshot, probing cycle, compensation, claim and heartbeat."""

import asyncio
import math
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from typing import Any, Final

from drivers.base import BadAnswer, Clock, DriverError, Refused
from drivers.linuxcnc.line import Json, LinuxCncLine
from drivers.linuxcnc.settings import LinuxCncSettings
from drivers.nc import (
    ERRORS,
    LINEAR_AXES,
    ROTARY_AXES,
    NcSnapshot,
    NineErrors,
    OperatingMode,
    ProbingState,
    ProgramState,
    RequestStatus,
    WatchdogTerms,
    check_errors,
    check_number,
    check_offsets,
)

AXES = LINEAR_AXES + ROTARY_AXES
_POLL_S, _THERE_UM = 0.02, 1e-3
STATES: Final = ("spindle_speed", *(f"speed_{axis}" for axis in AXES), "coolant")
"""Every machine state that the agent reports: 1/min, mm/min, 0 or 1."""
EMERGENCY_STOP: Final = 1
"""Shown as an alarm; LinuxCNC itself has no alarm numbers."""


class LinuxCnc:
    """One control. Construction validates and uses no network; see NumericalControl for the operations.

    Every operation raises a DriverError: after any but Refused the line is closed and `connect` is needed.
    """

    def __init__(self, settings: LinuxCncSettings, clock: Clock) -> None:
        self._settings, self._clock = settings, clock
        self._line = LinuxCncLine(settings)
        self._owner = 0
        self._reach: tuple[float, float] | None = None

    async def connect(self) -> None:
        """Log in and read everything once."""
        self._owner = 0
        try:
            self._reach = self._told_reach(await self._line.connect())
            await self.snapshot()
            await self.read_compensation()
        except BaseException:
            await self._line.close()
            raise

    async def close(self) -> None:
        await self._line.close()

    async def snapshot(self) -> NcSnapshot:
        """Positions: the tool tip relative to where A and C meet. Speeds: the mean since the last snapshot."""
        status = self._table(await self._line.ask("status"), "status")
        positions = self._numbers(status.get("positions"), "positions")
        if missing := set(AXES) - set(positions):
            raise self._bad(f"positions without {', '.join(sorted(missing))}")
        tool, probing, cannot_probe = (status.get(name) for name in ("tool", "probing", "cannot_probe"))
        return NcSnapshot(
            time=self._clock.utc(),
            monotonic_s=self._clock.monotonic(),
            positions={axis: positions[axis] for axis in AXES},
            states=self._numbers(status.get("states"), "states"),
            mode=_member(OperatingMode, status.get("mode"), OperatingMode.UNKNOWN),
            program=_member(ProgramState, status.get("program"), ProgramState.UNKNOWN),
            tool=tool if isinstance(tool, int) else None,
            probe_in_spindle=bool(status.get("probe")),
            alarms=(EMERGENCY_STOP,) if status.get("estop") else (),
            probing=probing if isinstance(probing, bool) else None,
            ready=bool(status.get("on")) and bool(status.get("homed")) and not status.get("estop"),
            cannot_probe=cannot_probe if isinstance(cannot_probe, str) else None,
        )

    async def request_probing(self, number: int) -> None:
        """Raises ValueError for a number outside 1 .. 2**31 - 1, Refused when the control saw this number last or has
        another request pending."""
        check_number(number, "request number")
        await self._line.ask("probe", number=number, valid_for_s=self._settings.request_valid_for_s)

    async def probing_status(self, number: int) -> RequestStatus:
        """State of request `number`; idle when the control has since received another one, or has received none."""
        check_number(number, "request number")
        told = self._table(await self._line.ask("probing", number=number), "probing")
        state = _member(ProbingState, told.get("state"), None)
        if state is None:
            raise self._bad(f"probing state {told.get('state')!r} is unknown")
        if state is not ProbingState.DONE:
            return RequestStatus(number, state, reason=str(told.get("reason", "")))
        centres = told.get("centres")
        if not isinstance(centres, list) or len(centres) != self._settings.poses:
            raise self._bad(f"cycle {number} is done without {self._settings.poses} centres")
        return RequestStatus(
            number,
            state,
            centres_mm=tuple(self._three(centre, "centre") for centre in centres),
            spread_mm=self._number(told.get("spread"), "spread"),
            in_force_um=None if self._reach is None else self._three(told.get("in_force"), "offsets during the cycle"),
        )

    async def withdraw_probing(self, number: int) -> None:
        """Withdraw the request; a cycle in progress is stopped before its next touch."""
        check_number(number, "request number")
        await self._line.ask("withdraw", number=number)

    async def write_compensation(self, offsets_um: tuple[float, float, float]) -> None:
        """Returns when the offsets are in force, or after timeout_s.

        Raises NotSendable, before anything is sent, for a number that is not finite or beyond `largest_um`.
        """
        check_offsets(offsets_um, self._settings.largest_um)
        await self._line.ask("write", owner=self._owner, um=[float(v) for v in offsets_um])
        await self._in_force(self.read_compensation, offsets_um)

    async def _in_force(self, read: Callable[[], Awaitable[Sequence[float]]], wanted: Sequence[float]) -> None:
        """The control slews. The next read-back must return what was written, unless something else is wrong."""
        with suppress(TimeoutError):
            async with asyncio.timeout(self._settings.timeout_s):
                while any(abs(a - b) >= _THERE_UM for a, b in zip(await read(), wanted, strict=True)):
                    await asyncio.sleep(_POLL_S)

    @property
    def error_reach_mm(self) -> tuple[float, float] | None:
        return self._reach

    async def write_errors(self, errors: NineErrors) -> None:
        """Returns when the errors are in force, or after timeout_s.

        Raises NotSendable, before anything is sent, for a number that is not finite or an error beyond `largest_um`.
        """
        check_errors(errors, self._settings.largest_um)
        await self._line.ask(
            "write_errors",
            owner=self._owner,
            errors=[float(v) for v in errors.errors],
            radius_mm=errors.radius_mm,
            bound_um=[float(v) for v in errors.bound_um],
        )
        await self._in_force(lambda: self.read_errors(errors.radius_mm), errors.errors)

    async def read_errors(self, radius_mm: float) -> tuple[float, ...]:
        told = await self._line.ask("errors", radius_mm=radius_mm)
        if not isinstance(told, list) or len(told) != ERRORS:
            raise self._bad(f"errors in force: expected {ERRORS} numbers")
        return tuple(self._number(value, "errors in force") for value in told)

    def _told_reach(self, greeting: Json) -> tuple[float, float] | None:
        """Of an agent that takes the nine errors; earlier ones greet with a list of their commands."""
        if not isinstance(greeting, dict):
            return None
        can = greeting.get("capabilities")
        if not isinstance(can, list) or "errors" not in can:
            return None
        reach = greeting.get("reach_mm")
        if not isinstance(reach, list) or len(reach) != 2:
            raise self._bad(f"reach_mm = {reach!r}: expected two numbers")
        along, across = (self._number(value, "reach_mm") for value in reach)
        if min(along, across) <= 0:
            raise self._bad(f"reach_mm = {reach!r}: expected more than 0")
        return along, across

    async def read_compensation(self) -> tuple[float, float, float]:
        return self._three(await self._line.ask("read"), "offsets in force")

    async def claim(self, owner: int, terms: WatchdogTerms, predecessor: int | None = None) -> None:
        """Returns when the watchdog is active, or after timeout_s.

        Raises ValueError for an owner outside 1 .. 2**31 - 1.
        """
        check_number(owner, "owner")
        told: dict[str, Json] = {"silence_s": terms.silence_s, "ramp_um_per_s": terms.ramp_um_per_s}
        if predecessor is not None:
            told["predecessor"] = predecessor
        try:
            await self._line.ask("claim", owner=owner, **told)
        except Refused as error:
            hint = "stop the other gateway, or run this one in the mode monitor or advise"
            raise Refused(error.what, device=self._settings.device, hint=hint) from error
        # The claim is a beat, which real time sees in its next cycle; the next beat must find the watchdog active.
        with suppress(TimeoutError):
            async with asyncio.timeout(self._settings.timeout_s):
                while not await self.heartbeat(owner):
                    await asyncio.sleep(_POLL_S)

    async def heartbeat(self, owner: int) -> bool:
        check_number(owner, "owner")
        watched = await self._line.ask("heartbeat", owner=owner) is True
        self._owner = owner
        return watched

    async def release(self, owner: int) -> None:
        check_number(owner, "owner")
        await self._line.ask("release", owner=owner)

    def _table(self, answer: Json, what: str) -> dict[str, Json]:
        if not isinstance(answer, dict):
            raise self._bad(f"{what}: expected an object")
        return answer

    def _numbers(self, answer: Json, what: str) -> dict[str, float]:
        return {name: self._number(value, f"{what} {name}") for name, value in self._table(answer, what).items()}

    def _three(self, answer: Json, what: str) -> tuple[float, float, float]:
        if not isinstance(answer, list) or len(answer) != 3:
            raise self._bad(f"{what}: expected three numbers")
        x, y, z = (self._number(value, what) for value in answer)
        return x, y, z

    def _number(self, value: Json, what: str) -> float:
        with suppress(OverflowError):  # JSON's integers may be longer than any float
            if not isinstance(value, bool) and isinstance(value, (int, float)) and math.isfinite(value):
                return float(value)
        raise self._bad(f"{what} = {value!r}: expected a finite number")

    def _bad(self, what: str) -> DriverError:
        return BadAnswer(what, device=self._settings.device, hint="is the agent of another version?")


def _member(kind: Any, value: Json, default: Any) -> Any:
    return next((member for member in kind if member.value == value), default)
