"""A control in memory, and the link at work on it in stepped time."""

import asyncio
import math
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from drivers.base import ConnectError, NoAnswer, Refused
from drivers.nc import NcSnapshot, NotSendable, OperatingMode, ProbingState, ProgramState, RequestStatus, WatchdogTerms
from gateway.config.extended import validate
from gateway.config.model import GatewayConfig
from gateway.model.commands import Disarmed, Pause
from gateway.model.compensation import Offsets, Write
from gateway.model.probing import Outcome
from gateway.model.text import Text
from gateway.nc.link import NcLink
from gateway.nc.settings import Earlier, Identity, LinkSettings, Listeners
from talc.frame import Decision, Phase, Why
from tests.benches.stepped_clock import SteppedClock


@dataclass
class ScriptedControl:
    """A control in memory: answers, and notes every write."""

    clock: SteppedClock
    in_force: Offsets = (0.0, 0.0, 0.0)
    writes: list[tuple[float, Offsets]] = field(default_factory=list)
    requests: list[int] = field(default_factory=list)
    withdrawn: list[int] = field(default_factory=list)
    runs_dry: bool | None = False
    path_mark: str = ""
    busy: bool = False
    """Takes no request for probing."""
    absent: bool = False
    deaf: bool = False
    """Takes a write and does not apply it."""
    spoils: bool = False
    """Takes a write and has no number in force afterwards."""
    answer: RequestStatus | None = None
    answers: dict[int, RequestStatus] = field(default_factory=dict)
    """By request number; the others get `answer`."""
    beats: list[float] = field(default_factory=list)
    watching: bool = True
    owner: int = 0
    mode: OperatingMode = OperatingMode.AUTO
    program: ProgramState = ProgramState.ABORTED
    speed: float = 0.0
    ready: bool | None = None
    probing: bool | None = None
    slow: asyncio.Event | None = None
    """A write lasts until it is set."""
    in_write: bool = False
    """A write has been sent whose answer has not come."""
    late: asyncio.Event | None = None
    """A write acts at once, and is answered when it is set."""
    swallows: bool = False
    """Takes a write and does not answer."""
    loses: bool = False
    """Takes no write in time: the next one is lost, without an answer, and kept in `lost`."""
    lost: Offsets | None = None
    halts_s: float = 0.0
    """How long this process stands still before its next write acts."""
    late_write_s: float = 0.0
    """The control's statement: how long after it was sent an unanswered write may take effect."""
    closed: int = 0
    looks: int = 0
    garbled: set[int] = field(default_factory=set)
    """Looks whose answer has a changed byte."""
    hangs: str = ""
    """Within its next "beat", "look" or "read back" the gateway stands still, and the watchdog has acted meanwhile."""

    def _here(self) -> None:
        if self.absent:
            raise ConnectError("no answer", device="nc")

    async def connect(self) -> None:
        self._here()

    async def close(self) -> None:
        self.closed += 1

    async def snapshot(self) -> NcSnapshot:
        self._here()
        positions = {"X": 0.0, "Y": 0.0, "Z": 0.0, "A": 0.0, "C": 0.0}
        states = {"coolant": 1.0, "spindle_speed": self.speed}
        return NcSnapshot(
            self.clock.utc(), self.clock.monotonic(), positions, states, self.mode, self.program,
            ready=self.ready, probing=self.probing,
        )  # fmt: skip

    async def request_probing(self, number: int, dry_run_mm: float = 0.0) -> None:
        if self.busy:
            raise Refused("another cycle is under way", device="nc")
        self.requests.append(number)

    async def probing_status(self, number: int) -> RequestStatus:
        if self.late is not None:
            self.in_write = True
            await self._answer(self.late)
        answer = self.answers.get(number, self.answer)
        return RequestStatus(number, ProbingState.RUNNING) if answer is None else replace(answer, number=number)

    async def withdraw_probing(self, number: int) -> None:
        self._here()
        if self.busy:
            raise Refused("not now", device="nc")
        self.withdrawn.append(number)

    async def write_compensation(self, offsets_um: Offsets) -> None:
        if self.slow is not None:
            self.in_write = True
            await self.slow.wait()
        if max(map(abs, offsets_um)) > 500.0:
            raise NotSendable(f"offsets_um = {offsets_um!r}: beyond largest_um = 500; nothing was sent")
        if self.loses:
            self.loses, self.lost = False, offsets_um
            raise NoAnswer("nothing within 2 s", device="nc")
        if self.halts_s:
            self.clock.spend(self.halts_s)
            self.halts_s = 0.0
        self.writes.append((self.clock.monotonic(), offsets_um))
        if self.swallows:
            self.in_force = offsets_um
            raise NoAnswer("nothing within 2 s", device="nc")
        if not self.deaf:
            self.in_force = (math.nan, 0.0, 0.0) if self.spoils else offsets_um
        if self.late is not None:
            self.in_write = True
            await self._answer(self.late)

    async def _answer(self, when: asyncio.Event) -> None:
        """Answer as on a connection whose answers come in turn: a client that does not wait for its own answer loses
        the connection."""
        try:
            await when.wait()
        except asyncio.CancelledError:
            self.absent = True
            raise

    async def claim(self, owner: int, terms: WatchdogTerms, predecessor: int | None = None) -> None:
        if self.owner not in (0, owner, predecessor):
            raise Refused(f"belongs to gateway {self.owner}", device="nc")
        self.owner = owner

    async def heartbeat(self, owner: int) -> bool:
        if self.owner != owner:
            raise Refused(f"belongs to gateway {self.owner}", device="nc")
        self.beats.append(self.clock.monotonic())
        self._hang("beat")
        return self.watching

    async def release(self, owner: int) -> None:
        self._here()
        if self.owner == owner:
            self.owner = 0

    async def read_compensation(self) -> Offsets:
        answer, self.looks = self.in_force, self.looks + 1
        self._hang("look")
        if self.looks % 2 == 0:  # the first look of a step comes before the write, the second after it
            self._hang("read back")
            answer = self.in_force
        return (answer[0] + 8.0, *answer[1:]) if self.looks in self.garbled else answer

    def _hang(self, within: str) -> None:
        if self.hangs == within:
            self.clock.spend(6.0)
            self.hangs, self.in_force = "", (0.0, 0.0, 1.0)


def config(
    mode: str,
    *,
    when_stale: str = "zero",
    armed: bool = True,
    shipped: bool = False,
    dry_run: str = "required",
    **more: float,
) -> GatewayConfig:
    """A configuration. shipped: no time of the compensation is set, as in a new configuration."""
    stale = {} if shipped else {"stale_after_s": 60.0}
    return validate(
        {
            "machine": {"name": "mill"},
            "nc": {"kind": "sinumerik", "url": "opc.tcp://127.0.0.1:4840", "security": "none", "period_s": 1.0},
            "probing": {"armed": armed, "poll_s": 1.0, "dry_run": dry_run},
            "compensation": {"mode": mode, "when_stale": when_stale} | stale | more,
        }
    )


def decision(ez0a: float) -> Decision:
    errors = np.zeros(9)
    errors[1] = ez0a  # at A = 0 this is the offset in Z
    nan = np.full(9, math.nan)
    return Decision(5, Phase.COMPENSATION, errors, errors, nan, nan, None, None, ())


class LinkBench:
    """A link, its control and what it reported."""

    def __init__(
        self,
        mode: str,
        in_force: Offsets = (0.0, 0.0, 0.0),
        *,
        when_stale: str = "zero",
        armed: bool = True,
        shipped: bool = False,
        abandoned: int | None = None,
        measured: Sequence[float] | None = None,
        paused: Pause | None = None,
        disarmed: Disarmed | None = None,
        proven: bool = True,
        dry_run: str = "required",
        paths: frozenset[str] | None = None,
        **more: float,
    ) -> None:
        self.clock = SteppedClock()
        self.control = ScriptedControl(self.clock, in_force)
        self.steps: list[Write] = []
        self.disk_full = False
        self.notices: list[Text] = []
        self.states: list[Mapping[str, float]] = []
        self.link = NcLink(
            self.control,
            self.clock,
            LinkSettings.of(
                config(mode, when_stale=when_stale, armed=armed, shipped=shipped, dry_run=dry_run, **more), Identity()
            ),
            Earlier(41, abandoned, measured_s=measured, paused=paused, disarmed=disarmed, proven=proven, paths=paths),
            Listeners(
                states=lambda states, _: self.states.append(states),
                written=self.store,
                notify=lambda notice: self.notices.append(notice.text),
            ),
        )

    def store(self, write: Write) -> None:
        if self.disk_full:
            raise OSError("no space left on device")
        self.steps.append(write)

    @asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """The link runs inside. Raises what ended it, unless that was the full disk."""
        task = asyncio.create_task(self.link.run())
        try:
            yield
        finally:
            task.cancel()
            [ended] = await asyncio.gather(task, return_exceptions=True)
        if isinstance(ended, Exception) and not self.disk_full:
            raise ended

    @asynccontextmanager
    async def following(self, z_um: float, until_s: float) -> AsyncIterator[None]:
        """The link runs inside, after it has followed this offset in Z until then."""
        async with self.running():
            self.link.follow(decision(z_um))
            await self.clock.run_until(until_s)
            yield

    async def stopped(self, until_s: float) -> None:
        """Stop the link, which has ended by then."""
        stopping = asyncio.create_task(self.link.stop())
        await self.clock.run_until(until_s)
        await stopping

    async def measured(self, until_s: float, why: Why = Why.INTERVAL) -> Outcome:
        """The result of a measurement that begins now and has ended by then."""
        cycle = asyncio.create_task(self.link.measure(why))
        await self.clock.run_until(until_s)
        return await cycle

    async def abandon_measurement(self, until_s: float) -> None:
        """Ask for a measurement now; at this time nobody waits for it any more."""
        cycle = asyncio.create_task(self.link.measure(Why.INTERVAL))
        await self.clock.run_until(until_s)
        cycle.cancel()
        await asyncio.gather(cycle, return_exceptions=True)


def answer_wrongly(bench: LinkBench, operation: str, wrong: Callable[[Any], object]) -> Callable[[], None]:
    """Change the operation's answers from now on; call what is returned to repair it."""
    genuine: Callable[..., Awaitable[object]] = getattr(bench.control, operation)

    async def answers(*given: object) -> object:
        return wrong(await genuine(*given))

    setattr(bench.control, operation, answers)
    return lambda: delattr(bench.control, operation)
