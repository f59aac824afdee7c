"""Any control through its agent: snapshot, probing cycle, compensation, claim and heartbeat. See docs/agent.md."""

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from typing import Any, Final

from drivers.agent.connection import AgentConnection, Json
from drivers.agent.greeting import Capability, Greeting, greeting_of
from drivers.agent.numbers import finite_number, finite_numbers, json_object, triple
from drivers.agent.settings import AgentSettings
from drivers.agent.slopes import AgentSlopes
from drivers.base import BadAnswer, Clock, Refused
from drivers.nc import (
    AXES,
    ERRORS,
    NcSnapshot,
    NineErrors,
    NotSendable,
    OperatingMode,
    ProbingState,
    ProgramState,
    RequestStatus,
    WatchdogTerms,
    check_errors,
    check_height,
    check_number,
    check_offsets,
)
from drivers.text import Text

_POLL_S = 0.02
"""From one look at what is in force to the next."""
_THERE_UM = 1e-3
"""An offset that differs by no more than this, and does not move, is in force: a control may round."""
_EXACT_UM = 1e-9
_ROUNDED = 1e-6
"""Of a bound that was converted."""
_EMERGENCY_STOP: Final = 1
"""Shown as an alarm, beside those that the agent reports."""
NO_CYCLE: Final = Text("agent_no_cycle")
_OFFSETS: Final = frozenset({Capability.SHIFT, Capability.SLOPES, Capability.ERRORS})


class AgentControl:
    """One control. Construction validates and uses no network; see NumericalControl for the operations.

    Every operation raises a DriverError: after any but Refused the connection is closed and `connect` is needed.
    """

    def __init__(self, settings: AgentSettings, clock: Clock) -> None:
        self._settings, self._clock = settings, clock
        self._agent = AgentConnection(settings)
        self._owner = 0
        self._greeting = Greeting()
        self._slopes: AgentSlopes | None = None

    async def connect(self) -> None:
        """Log in and read everything once."""
        self._owner, settings = 0, self._settings
        try:
            greeting = greeting_of(await self._agent.connect(), settings.device)
            greeting.check_poses(settings.poses, settings.poses_deg, settings.device)
            self._greeting = greeting
            self._slopes = None
            if greeting.travel is not None:
                agent, owner = self._agent, lambda: self._owner
                self._slopes = AgentSlopes(agent, settings, greeting.travel, owner, self._in_force)
            await self.snapshot()
            await self.read_compensation()
        except BaseException:
            await self._agent.close()
            raise

    async def close(self) -> None:
        await self._agent.close()

    async def snapshot(self) -> NcSnapshot:
        """Positions: the tool tip relative to where A and C meet. Speeds: the mean since the last snapshot."""
        status = json_object(await self._agent.ask("status"), "status", self._settings.device)
        positions = self._named(status.get("positions"), "positions")
        if missing := set(AXES) - set(positions):
            raise BadAnswer(Text("agent_positions", names=", ".join(sorted(missing))), device=self._settings.device)
        tool, probing, cannot_probe = (status.get(name) for name in ("tool", "probing", "cannot_probe"))
        if Capability.PROBE not in self._greeting.can:
            cannot_probe = NO_CYCLE
        stopped = status.get("estop") is not False
        return NcSnapshot(
            time=self._clock.utc(),
            monotonic_s=self._clock.monotonic(),
            positions={axis: positions[axis] for axis in AXES},
            states=self._named(status.get("states"), "states"),
            mode=_member(OperatingMode, status.get("mode"), OperatingMode.UNKNOWN),
            program=_member(ProgramState, status.get("program"), ProgramState.UNKNOWN),
            tool=tool if isinstance(tool, int) else None,
            probe_in_spindle=status.get("probe") is True,
            alarms=(_EMERGENCY_STOP,) * (status.get("estop") is True) + self._alarms(status.get("alarms", [])),
            probing=probing if isinstance(probing, bool) else None,
            ready=status.get("on") is True and status.get("homed") is True and not stopped,
            cannot_probe=cannot_probe if isinstance(cannot_probe, str) else None,
            cannot_probe_code=_code(status.get("cannot_probe_code")),
        )

    @property
    def runs_dry(self) -> bool:
        """Implements RunsDry."""
        return {Capability.PROBE, Capability.DRY_RUN} <= self._greeting.can

    @property
    def path_mark(self) -> str:
        """Implements MarksPath."""
        return self._greeting.path

    async def request_probing(self, number: int, dry_run_mm: float = 0.0) -> None:
        """Raises ValueError for a number outside 1 .. 2**31 - 1 or a height outside 0 .. 1000 mm, Refused when the
        control saw this number last or has another request pending."""
        check_number(number, "request number")
        check_height(dry_run_mm)
        if dry_run_mm and self._agent.is_open and not self.runs_dry:
            raise Refused(Text("agent_no_dry_runs"), device=self._settings.device, hint=Text("agent_update"))
        height: dict[str, Json] = {"dry_run_mm": dry_run_mm} if dry_run_mm else {}
        await self._agent.ask("probe", number=number, valid_for_s=self._settings.request_valid_for_s, **height)

    async def probing_status(self, number: int) -> RequestStatus:
        """State of request `number`; idle when the control has since received another one, or has received none."""
        check_number(number, "request number")
        device = self._settings.device
        told = json_object(await self._agent.ask("probing", number=number), "probing", device)
        state = _member(ProbingState, told.get("state"), None)
        if state is None:
            raise BadAnswer(Text("agent_probing_state", state=repr(told.get("state"))), device=device)
        if state is not ProbingState.DONE:
            return RequestStatus(number, state, reason=str(told.get("reason", "")), code=_code(told.get("code")))
        centres = told.get("centres")
        if not isinstance(centres, list) or len(centres) != self._settings.poses:
            raise BadAnswer(Text("agent_no_centres", number=number, poses=self._settings.poses), device=device)
        told_in_force = Capability.ERRORS in self._greeting.can or self._greeting.version >= 3
        return RequestStatus(
            number,
            state,
            centres_mm=tuple(triple(centre, "centre", device) for centre in centres),
            spread_mm=finite_number(told.get("spread"), "spread", device),
            in_force_um=triple(told.get("in_force"), "offsets during the cycle", device) if told_in_force else None,
        )

    async def withdraw_probing(self, number: int) -> None:
        """Withdraw the request; a cycle in progress is stopped before its next touch."""
        check_number(number, "request number")
        await self._agent.ask("withdraw", number=number)

    async def write_compensation(self, offsets_um: tuple[float, float, float]) -> None:
        """Returns when the offsets are in force, or after timeout_s.

        Raises NotSendable, before anything is sent, for a number that is not finite or beyond `largest_um`.
        """
        check_offsets(offsets_um, self._settings.largest_um)
        await self._agent.ask("write", owner=self._owner, um=[float(v) for v in offsets_um])
        await self._in_force(self.read_compensation, offsets_um)

    async def _in_force(self, read: Callable[[], Awaitable[Sequence[float]]], wanted: Sequence[float]) -> None:
        """The control slews. The next read-back must return what was written, unless something else is wrong.

        What is near may still move: over a long reach a thousandth of ER0T is more than the gateway lets pass.
        """
        before: Sequence[float] = ()

        async def there() -> bool:
            nonlocal before
            now = await read()
            stands, before = now == before, now
            away = max(abs(a - b) for a, b in zip(now, wanted, strict=True))
            return away < _EXACT_UM or (stands and away < _THERE_UM)

        await self._until(there)

    async def _until(self, done: Callable[[], Awaitable[bool]]) -> None:
        """Ask until it is so, for timeout_s. No question is cancelled, which would close the connection."""
        loop = asyncio.get_running_loop()
        latest_s = loop.time() + self._settings.timeout_s
        while not await done() and loop.time() < latest_s:
            await asyncio.sleep(_POLL_S)

    @property
    def error_reach_mm(self) -> tuple[float, float] | None:
        return self._greeting.error_reach_mm

    @property
    def slopes(self) -> AgentSlopes | None:
        return self._slopes

    async def write_errors(self, errors: NineErrors) -> None:
        """Returns when the errors are in force, or after timeout_s.

        Raises NotSendable, before anything is sent, for a number that is not finite, an error beyond `largest_um`, or a
        bound beyond the agent's, which would cut the offsets unseen.
        """
        check_errors(errors, self._settings.largest_um)
        bound_um, most_um = max(errors.bound_um), self._greeting.bound_um
        if bound_um > most_um * (1.0 + _ROUNDED):
            raise NotSendable(Text("agent_bound", bound_um=bound_um, most_um=most_um))
        await self._agent.ask(
            "write_errors",
            owner=self._owner,
            errors=[float(v) for v in errors.errors],
            radius_mm=errors.radius_mm,
            bound_um=[float(v) for v in errors.bound_um],
        )
        await self._in_force(lambda: self.read_errors(errors.radius_mm), errors.errors)

    async def read_errors(self, radius_mm: float) -> tuple[float, ...]:
        told = await self._agent.ask("errors", radius_mm=radius_mm)
        return finite_numbers(told, ERRORS, "errors in force", self._settings.device)

    async def read_compensation(self) -> tuple[float, float, float]:
        """Nothing is in force by an agent that takes no offsets."""
        if not self._greeting.can & _OFFSETS and self._agent.is_open:
            return 0.0, 0.0, 0.0
        return triple(await self._agent.ask("read"), "offsets in force", self._settings.device)

    async def claim(self, owner: int, terms: WatchdogTerms, predecessor: int | None = None) -> None:
        """Returns when the watchdog is active, or after timeout_s.

        Raises ValueError for an owner outside 1 .. 2**31 - 1, Refused for an agent that takes no offsets.
        """
        check_number(owner, "owner")
        self._check_takes_offsets()
        told: dict[str, Json] = {"silence_s": terms.silence_s, "ramp_um_per_s": terms.ramp_um_per_s}
        if predecessor is not None:
            told["predecessor"] = predecessor
        try:
            await self._agent.ask("claim", owner=owner, **told)
        except Refused as error:
            hint = Text("stop_other_gateway")
            raise Refused(error.what, device=self._settings.device, reason=error.reason, hint=hint) from error
        # The claim is a beat, which real time sees in its next cycle; the next beat must find the watchdog active.
        await self._until(lambda: self.heartbeat(owner))

    async def heartbeat(self, owner: int) -> bool:
        check_number(owner, "owner")
        watched = await self._agent.ask("heartbeat", owner=owner) is True
        self._owner = owner
        return watched

    async def release(self, owner: int) -> None:
        check_number(owner, "owner")
        await self._agent.ask("release", owner=owner)

    def _check_takes_offsets(self) -> None:
        if self._agent.is_open and not self._greeting.can & _OFFSETS:
            hint = Text("mode_works")
            raise Refused(Text("agent_no_offsets"), device=self._settings.device, hint=hint)

    def _named(self, answer: Json, what: str) -> dict[str, float]:
        device = self._settings.device
        return {
            name: finite_number(value, f"{what} {name}", device)
            for name, value in json_object(answer, what, device).items()
        }

    def _alarms(self, told: Json) -> tuple[int, ...]:
        if not isinstance(told, list) or not all(type(alarm) is int for alarm in told):  # a bool would be an int
            raise BadAnswer(Text("agent_alarms", told=repr(told)), device=self._settings.device)
        return tuple(alarm for alarm in told if isinstance(alarm, int))


def _code(value: Json) -> str:
    return value if isinstance(value, str) else ""


def _member(kind: Any, value: Json, default: Any) -> Any:
    return next((member for member in kind if member.value == value), default)
