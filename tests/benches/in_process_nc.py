"""The emulated control without a wire: what NumericalControl means, in as little code as possible."""

import math

from drivers.base import Clock, ConnectError, Refused
from drivers.nc import (
    NcSnapshot,
    NotSendable,
    OperatingMode,
    ProbingState,
    ProgramState,
    RequestStatus,
    WatchdogTerms,
)
from simulators.nc import Nck, ReasonCode
from simulators.nc.cycle import CycleState
from simulators.nc.moves import AXIS_LETTERS
from simulators.nc.nck import R_DRY_RUN, R_REQUEST, R_VALID_FOR, R_WITHDRAW, VERSION
from simulators.nc.watchdog import R_BEAT, R_OWNER, R_RAMP, R_SILENCE, R_WATCH, WatchState

MODES = (OperatingMode.JOG, OperatingMode.MDA, OperatingMode.AUTO)
PROGRAMS = {1: ProgramState.INTERRUPTED, 2: ProgramState.STOPPED, 3: ProgramState.RUNNING}
LARGEST_UM = 500.0


class InProcess:
    """Implements NumericalControl over the NC kernel itself."""

    def __init__(self, nck: Nck, clock: Clock) -> None:
        self._kernel, self._clock, self._open = nck, clock, False

    @property
    def _nck(self) -> Nck:
        if not self._open:
            raise ConnectError("not connected", device="nc", hint="connect first")
        self._kernel.advance(self._clock.monotonic())
        return self._kernel

    async def connect(self) -> None:
        self._open = True

    async def close(self) -> None:
        self._open = False

    async def snapshot(self) -> NcSnapshot:
        now = self._nck.state(self._clock.monotonic())
        loads = now.loads
        states = {"spindle_speed": loads.spindle, "coolant": loads.coolant}
        states |= {f"speed_{axis}": value for axis, value in zip(AXIS_LETTERS, loads.as_tuple(), strict=False)}
        return NcSnapshot(
            self._clock.utc(), self._clock.monotonic(), now.positions, states, MODES[now.mode],
            PROGRAMS[now.program_status], now.tool, now.probing, now.alarms,
            probing=self._nck.cycle.started_s is not None,
        )  # fmt: skip

    @property
    def runs_dry(self) -> bool:
        return self._kernel.version == VERSION

    async def request_probing(self, number: int, dry_run_mm: float = 0.0) -> None:
        _check(number, "request number")
        if not 0 <= dry_run_mm <= 1000:
            raise ValueError(f"dry_run_mm = {dry_run_mm!r}")
        if dry_run_mm and not self.runs_dry:
            raise Refused("the program knows no dry runs", device="nc")
        if number in (self._nck.r[R_REQUEST], self._nck.cycle.answer.number):
            raise Refused(f"request number {number} was the last one", device="nc")
        waits = self._nck.r[R_REQUEST]
        if self._nck.cycle.started_s is not None or waits not in (0.0, self._nck.cycle.answer.number):
            raise Refused(f"request {max(waits, self._nck.cycle.answer.number):.0f} is not over", device="nc")
        self._nck.write_r(R_VALID_FOR, 900.0, self._clock.monotonic())
        self._nck.write_r(R_DRY_RUN, dry_run_mm, self._clock.monotonic())
        self._nck.write_r(R_REQUEST, float(number), self._clock.monotonic())

    async def probing_status(self, number: int) -> RequestStatus:
        _check(number, "request number")
        answer = self._nck.cycle.answer
        if answer.number != number or answer.state is CycleState.IDLE:
            waits = self._nck.r[R_REQUEST] == number
            return RequestStatus(number, ProbingState.REQUESTED if waits else ProbingState.IDLE)
        reason = {ReasonCode.WITHDRAWN: "withdrawn", ReasonCode.ALARM: "an alarm is active"}.get(answer.reason)
        text = "" if answer.reason is ReasonCode.NONE else reason or answer.reason.name.lower()
        return RequestStatus(number, ProbingState(answer.state.name.lower()), answer.centres_mm or None, text)

    async def withdraw_probing(self, number: int) -> None:
        _check(number, "request number")
        self._nck.write_r(R_WITHDRAW, float(number), self._clock.monotonic())

    async def write_compensation(self, offsets_um: tuple[float, float, float]) -> None:
        if not all(math.isfinite(v) and abs(v) <= LARGEST_UM for v in offsets_um):
            raise NotSendable(f"offsets_um = {offsets_um!r}: expected finite numbers to largest_um; nothing was sent")
        for axis, value in enumerate(offsets_um):
            self._nck.write_k0(axis, -value * 1e-3, self._clock.monotonic())

    async def read_compensation(self) -> tuple[float, float, float]:
        at = self._nck.state(self._clock.monotonic()).positions
        return self._nck.shift_um((at["X"], at["Y"], at["Z"]))

    async def claim(self, owner: int, terms: WatchdogTerms, predecessor: int | None = None) -> None:
        _check(owner, "owner")
        holder = self._nck.r[R_OWNER]
        if holder not in (0, owner, predecessor) and self._nck.r[R_WATCH] == WatchState.ALIVE:
            raise Refused(f"the compensation belongs to gateway {holder:.0f}", device="nc")
        now = self._clock.monotonic()
        for number, value in (
            (R_SILENCE, terms.silence_s), (R_RAMP, terms.ramp_um_per_s * 1e-3), (R_OWNER, float(owner)),
            (R_BEAT, self._nck.r[R_BEAT] + 1.0),
        ):  # fmt: skip
            self._nck.write_r(number, value, now)

    async def heartbeat(self, owner: int) -> bool:
        _check(owner, "owner")
        if self._nck.r[R_OWNER] != owner:
            raise Refused(f"the compensation belongs to gateway {self._nck.r[R_OWNER]:.0f}", device="nc")
        watched = self._nck.r[R_WATCH] == WatchState.ALIVE
        self._nck.write_r(R_BEAT, self._nck.r[R_BEAT] + 1.0, self._clock.monotonic())
        return watched

    async def release(self, owner: int) -> None:
        _check(owner, "owner")
        if self._nck.r[R_OWNER] == owner:
            self._nck.write_r(R_OWNER, 0.0, self._clock.monotonic())


class WithoutDryRun(InProcess):
    """Its program knows no dry runs, so that a short life needs none."""

    @property
    def runs_dry(self) -> bool:
        return False


def _check(number: int, what: str) -> None:
    if not 1 <= number <= 2**31 - 1:
        raise ValueError(f"{what} = {number!r}: expected 1 to {2**31 - 1}")
