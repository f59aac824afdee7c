"""What somebody does within a probing cycle makes its result void, also when the control notices nothing."""

import asyncio
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest

from drivers.nc import NcSnapshot, OperatingMode, ProbingState, ProgramState
from gateway.model.probing import End, Outcome
from gateway.nc.link import NcLink
from gateway.nc.probing.foreign import CyclePath, CycleWatch
from gateway.nc.settings import Earlier, Identity, LinkSettings, Listeners
from simulators.nc import Activity, CycleSettings, DayPart, LoadCase, MeanLoads, Nck
from simulators.nc.nck import INTERRUPTED, JOG, MDA, STOPPED, Interference
from talc.frame import Why
from tests.benches.in_process_nc import InProcess
from tests.benches.nc_wire_bench import wants
from tests.benches.stepped_clock import SteppedClock
from tests.benches.still_machine import StillMachine
from tests.benches.wire_bench import config

CYCLE = CycleSettings(noise_um=0.0)
LIMIT_ALARM = 10621
"""A software limit switch is reached."""
Draw = np.random.Generator


def mode(draw: Draw, begin_s: float, end_s: float) -> Interference:
    return Interference(begin_s, end_s, mode=int(draw.choice([JOG, MDA])))


def stop(draw: Draw, begin_s: float, end_s: float) -> Interference:
    return Interference(begin_s, end_s, program_status=int(draw.choice([STOPPED, INTERRUPTED])))


def motion(draw: Draw, begin_s: float, end_s: float) -> Interference:
    """Beyond every place of the sphere: the widest of them is 240 mm from the opposite one."""
    axis = str(draw.choice(["X", "Y", "A"]))
    least = 190.0 if axis == "A" else 2 * CYCLE.radius_mm + 110.0
    way = float(draw.choice([-1.0, 1.0]) * draw.uniform(least, 2 * least))
    return Interference(begin_s, end_s, moved={axis: way})


def tool(draw: Draw, begin_s: float, end_s: float) -> Interference:
    return Interference(begin_s, end_s, tool=int(draw.integers(1, 20)))


DONE_TO_IT: tuple[Callable[[Draw, float, float], Interference] | str, ...] = (
    mode, stop, motion, tool, "limit", "jog",
)  # fmt: skip
"""The last two the control notices itself."""


class AtWork:
    """A link that compensates, on a control in memory."""

    def __init__(self) -> None:
        self.clock = SteppedClock()
        rest = LoadCase([DayPart(0.0, 1e9, Activity.PAUSE, MeanLoads())])
        self.nck = Nck(StillMachine(), rest, cycle=CYCLE)
        settings = replace(LinkSettings.of(config(), Identity()), path=CyclePath(CYCLE.poses_deg, 120.0, 80.0))
        earlier = Earlier(first_number=1, reference_mm=centres())
        self.link = NcLink(InProcess(self.nck, self.clock), self.clock, settings, earlier, Listeners())

    async def run(self, seconds: float) -> None:
        await self.clock.run_until(self.clock.monotonic() + seconds)

    async def measuring(self) -> tuple[asyncio.Task[None], asyncio.Task[Outcome]]:
        """The link's work, and a cycle that has run for a while."""
        running = asyncio.create_task(self.link.run())
        await self.run(2.0)
        measuring = asyncio.create_task(self.link.measure(Why.INTERVAL))
        await self.run(30.0)
        return running, measuring

    async def ended(self, measuring: asyncio.Task[Outcome]) -> Outcome:
        while not measuring.done():
            await self.run(5.0)
        return measuring.result()


def centres() -> np.ndarray:
    return np.array([CYCLE.nominal_centre_mm(pose) for pose in range(6)])


@pytest.mark.parametrize("count", [6, pytest.param(100, marks=pytest.mark.slow)])
async def test_every_drawn_disturbance_ends_void_and_the_offsets_go_on(count: int) -> None:
    draw = np.random.default_rng(20261129)
    at = AtWork()
    running = asyncio.create_task(at.link.run())
    try:
        await at.run(2.0)
        for number in range(count):
            kind = DONE_TO_IT[number % len(DONE_TO_IT)]
            at.link.follow(wants(float(draw.uniform(-8.0, 8.0))))
            await at.run(20.0)
            before = list(at.nck.k0_mm)
            measuring = asyncio.create_task(at.link.measure(Why.INTERVAL))
            await at.run(20.0 + float(draw.uniform(0.0, 60.0)))
            now, lasts_s = at.clock.monotonic(), float(draw.uniform(3.0, 20.0))
            assert at.nck.cycle.started_s is not None
            assert at.nck.k0_mm == before
            if kind == "limit":
                at.nck.raise_alarm(LIMIT_ALARM, now)
                await at.run(lasts_s)
                at.nck.clear_alarms(at.clock.monotonic())
            elif kind == "jog":
                at.nck.set_mode(JOG, now)
                await at.run(lasts_s)
                at.nck.set_mode(2, at.clock.monotonic())
            elif not isinstance(kind, str):
                at.nck.interference = kind(draw, now, now + lasts_s)
            outcome = await at.ended(measuring)
            assert (outcome.measurement, outcome.end) == (None, End.REJECTED), (number, kind)
            assert outcome.reason
            wanted = float(draw.uniform(-8.0, 8.0))
            at.link.follow(wants(wanted))
            await at.run(20.0)
            assert at.nck.k0_mm[2] == pytest.approx(-wanted * 1e-3), "it goes on from where it stood"
        measuring = asyncio.create_task(at.link.measure(Why.INTERVAL))
        assert (await at.ended(measuring)).end is End.MEASURED, "undisturbed"
    finally:
        running.cancel()
        with suppress(asyncio.CancelledError):
            await running


async def test_what_is_noticed_ends_the_cycle_at_once() -> None:
    at = AtWork()
    running, measuring = await at.measuring()
    now = at.clock.monotonic()
    at.nck.interference = Interference(now, now + 10.0, moved={"X": 500.0})
    await at.run(5.0)
    assert at.nck.cycle.started_s is None, "withdrawn"
    outcome = await measuring
    assert "X was at" in outcome.reason
    running.cancel()


def seen(**changed: object) -> NcSnapshot:
    plain = NcSnapshot(
        SteppedClock().utc(),
        0.0,
        {"X": 120.0, "Y": 0.0, "Z": 100.0, "A": 0.0, "C": 0.0},
        mode=OperatingMode.AUTO,
        program=ProgramState.RUNNING,
        tool=99,
        ready=True,
        probing=True,
    )
    return replace(plain, **changed)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("changed", "void"),
    [
        ({}, False),
        ({"mode": OperatingMode.JOG}, True),
        ({"mode": OperatingMode.UNKNOWN}, False),
        ({"program": ProgramState.ABORTED}, True),
        ({"program": ProgramState.WAITING}, False),
        ({"tool": 4}, True),
        ({"tool": None}, False),
        ({"alarms": (10621,)}, True),
        ({"ready": False}, True),
        ({"ready": None}, False),
        ({"positions": {"X": 221.0, "Y": 0.0, "Z": 100.0, "A": 0.0, "C": 0.0}}, True),
        ({"positions": {"X": 5.0, "Y": -219.0, "Z": -900.0, "A": -91.0, "C": 7000.0}}, False),
        ({"positions": {"X": 5.0, "Y": 0.0, "Z": 0.0, "A": 93.0, "C": 0.0}}, True),
        ({"probing": False, "tool": 4}, False),
    ],
)
def test_what_makes_a_running_cycle_void(changed: dict[str, object], void: bool) -> None:
    watch = CycleWatch(CyclePath(CYCLE.poses_deg, 120.0, 80.0))
    watch.begin()
    assert not watch.look(seen(mode=OperatingMode.JOG)), "nothing runs yet: the operator has the machine"
    watch.told(ProbingState.RUNNING)
    for snapshot in (seen(mode=OperatingMode.JOG), seen(), seen()):  # the first may be from before
        assert not watch.look(snapshot)
    found = []
    for _ in range(2):
        found.append(watch.look(seen(**changed)))
        watch.told(ProbingState.RUNNING)
    found.append(watch.look(seen()))
    assert sum(found) == bool(watch.found) == void
    watch.begin()
    assert not watch.found


@pytest.mark.parametrize("changed", [{"tool": 4}, {"positions": {"X": 5.0, "Y": 0.0, "Z": 0.0, "A": 93.0, "C": 0.0}}])
def test_a_probe_on_its_way_to_the_magazine_makes_no_cycle_void(changed: dict[str, object]) -> None:
    """The state is read once in poll_s, and a subscription may report the axes before it."""
    for ended in (ProbingState.ACCEPTED, ProbingState.DONE):
        watch = CycleWatch(CyclePath(CYCLE.poses_deg, 120.0, 80.0))
        watch.begin()
        watch.told(ProbingState.RUNNING)
        for snapshot in (seen(), seen(), seen(**changed)):
            assert not watch.look(snapshot)
        watch.told(ended)
        assert not watch.look(seen(**changed))
        assert not watch.found


async def test_a_hand_within_a_move_that_reaches_its_end_all_the_same_makes_the_cycle_void() -> None:
    """A SINUMERIK ends the cycle as usual: each of its moves ends where it was sent. Its program stood meanwhile."""
    at = AtWork()
    running, measuring = await at.measuring()
    now = at.clock.monotonic()
    at.nck.interference = Interference(now, now + 3.0, program_status=STOPPED, moved={"X": 2.0})
    outcome = await at.ended(measuring)
    assert (outcome.measurement, outcome.end) == (None, End.REJECTED)
    assert "the program was stopped" in outcome.reason
    running.cancel()
