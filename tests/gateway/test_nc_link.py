"""What reaches the NC: nothing unless armed, never a step, and nothing that the control does not confirm."""

import asyncio
import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from drivers.base import ConnectError, Refused
from drivers.nc import NcSnapshot, OperatingMode, ProbingState, ProbingStatus, ProgramState, Watch
from gateway.compensation import Offsets, Source, Write
from gateway.config import GatewayConfig
from gateway.config.model import validate
from gateway.measurement import End, Probe, poses_in_radians
from gateway.nc_link import NcLink
from talc.frame import Decision, Phase, Why
from tests.gateway.stepped_clock import SteppedClock

POSES = ((0.0, 0.0), (0.0, 90.0), (0.0, 180.0), (0.0, 270.0), (90.0, 0.0), (-90.0, 0.0))


@dataclass
class Control:
    """A control in memory: answers, and notes every write."""

    clock: SteppedClock
    in_force: Offsets = (0.0, 0.0, 0.0)
    writes: list[tuple[float, Offsets]] = field(default_factory=list)
    requests: list[int] = field(default_factory=list)
    withdrawn: list[int] = field(default_factory=list)
    absent: bool = False
    deaf: bool = False
    """Takes a write and does not apply it."""
    answer: ProbingStatus | None = None
    answers: dict[int, ProbingStatus] = field(default_factory=dict)
    """By request number; the others get `answer`."""
    beats: list[float] = field(default_factory=list)
    watching: bool = True
    owner: int = 0
    mode: OperatingMode = OperatingMode.AUTO
    program: ProgramState = ProgramState.ABORTED
    speed: float = 0.0
    slow: asyncio.Event | None = None
    """A write lasts until it is set."""
    in_write: bool = False

    async def connect(self) -> None:
        if self.absent:
            raise ConnectError("no answer", device="nc")

    async def close(self) -> None: ...

    async def snapshot(self) -> NcSnapshot:
        if self.absent:
            raise ConnectError("no answer", device="nc")
        positions = {"X": 0.0, "Y": 0.0, "Z": 0.0, "A": 0.0, "C": 0.0}
        states = {"coolant": 1.0, "spindle_speed": self.speed}
        return NcSnapshot(self.clock.utc(), self.clock.monotonic(), positions, states, self.mode, self.program)

    async def request_probing(self, number: int) -> None:
        self.requests.append(number)

    async def probing_status(self, number: int) -> ProbingStatus:
        return self.answers.get(number, self.answer) or ProbingStatus(number, ProbingState.RUNNING)

    async def withdraw_probing(self, number: int) -> None:
        self.withdrawn.append(number)

    async def write_compensation(self, offsets_um: Offsets) -> None:
        if self.slow is not None:
            self.in_write = True
            await self.slow.wait()
        self.writes.append((self.clock.monotonic(), offsets_um))
        if not self.deaf:
            self.in_force = offsets_um

    async def claim(self, owner: int, watch: Watch) -> None:
        if self.owner not in (0, owner):
            raise Refused(f"belongs to gateway {self.owner}", device="nc")
        self.owner = owner

    async def heartbeat(self, owner: int) -> bool:
        if self.owner != owner:
            raise Refused(f"belongs to gateway {self.owner}", device="nc")
        self.beats.append(self.clock.monotonic())
        return self.watching

    async def release(self, owner: int) -> None:
        if self.owner == owner:
            self.owner = 0

    async def read_compensation(self) -> Offsets:
        return self.in_force


def config(mode: str, *, when_stale: str = "zero", armed: bool = True) -> GatewayConfig:
    return validate(
        {
            "machine": {"name": "mill"},
            "nc": {"kind": "sinumerik", "url": "opc.tcp://127.0.0.1:4840", "security": "none", "period_s": 1.0},
            "probing": {"armed": armed, "poll_s": 1.0},
            "compensation": {"mode": mode, "when_stale": when_stale, "stale_after_s": 60.0},
        }
    )


def decision(ez0a: float) -> Decision:
    errors = np.zeros(9)
    errors[1] = ez0a  # at A = 0 this is the offset in Z
    nan = np.full(9, math.nan)
    return Decision(5, Phase.COMPENSATION, errors, errors, nan, nan, None, None, ())


class Bench:
    """A link, its control and what it told."""

    def __init__(
        self, mode: str, in_force: Offsets = (0.0, 0.0, 0.0), *, when_stale: str = "zero", armed: bool = True
    ) -> None:
        self.clock = SteppedClock()
        self.control = Control(self.clock, in_force)
        self.steps: list[Write] = []
        self.notices: list[str] = []
        self.link = NcLink(
            self.control,
            config(mode, when_stale=when_stale, armed=armed),
            self.clock,
            Probe(poses_in_radians(POSES), 0.12, 0.08, 1.0),
            states=lambda *_: None,
            written=self.steps.append,
            notify=lambda text, _: self.notices.append(text),
            reference_mm=None,
            first_number=41,
        )

    @asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        task = asyncio.create_task(self.link.run())
        try:
            yield
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)


@pytest.mark.parametrize("mode", ["monitor", "advise"])
async def test_unarmed_nothing_is_ever_written(mode: str) -> None:
    bench = Bench(mode)
    async with bench.running():
        bench.link.follow(decision(20.0))
        await bench.clock.run_until(30.0)
    await bench.link.stop()
    assert bench.control.writes == []
    assert bench.control.beats == []
    assert bench.control.owner == 0
    assert bench.steps[-1].step.offsets_um == (0.0, 0.0, 20.0)  # computed all the same
    assert not any(step.written for step in bench.steps)


async def test_unarmed_probing_asks_for_nothing() -> None:
    bench = Bench("compensate", armed=False)
    async with bench.running():
        await bench.clock.run_until(5.0)
        assert not bench.link.may_probe
        assert bench.link.present is not None
    assert bench.control.requests == []


async def test_armed_it_ramps_from_what_is_in_force_and_never_steps() -> None:
    bench = Bench("compensate", in_force=(3.0, 0.0, -5.0))
    async with bench.running():
        bench.link.follow(decision(4.0))
        await bench.clock.run_until(20.0)
    before = np.array([3.0, 0.0, -5.0])
    for _, offsets in bench.control.writes:
        assert (np.abs(np.array(offsets) - before) <= 1.0 + 1e-9).all()
        before = np.array(offsets)
    assert bench.control.in_force == (0.0, 0.0, 4.0)


async def test_a_stale_prediction_decays_to_the_declared_value() -> None:
    to_zero, held = Bench("compensate"), Bench("compensate", when_stale="hold")
    for bench in (to_zero, held):
        async with bench.running():
            bench.link.follow(decision(4.0))
            await bench.clock.run_until(100.0)
        assert bench.steps[-1].step.source is Source.STALE
    assert to_zero.control.in_force == (0.0, 0.0, 0.0)
    assert held.control.in_force == (0.0, 0.0, 4.0)


async def test_a_write_that_does_not_take_effect_disarms_and_says_so_once() -> None:
    bench = Bench("compensate")
    bench.control.deaf = True
    async with bench.running():
        bench.link.follow(decision(4.0))
        await bench.clock.run_until(20.0)
    assert not bench.link.armed
    assert len([n for n in bench.notices if "disarmed" in n]) == 1
    nonzero = [offsets for _, offsets in bench.control.writes if any(offsets)]
    assert len(nonzero) == 1


async def test_after_a_lost_connection_it_begins_from_what_is_in_force() -> None:
    bench = Bench("compensate")
    async with bench.running():
        bench.link.follow(decision(4.0))
        await bench.clock.run_until(10.0)
        bench.control.absent = True
        await bench.clock.run_until(20.0)
        bench.control.absent, bench.control.in_force = False, (0.0, 0.0, 0.0)  # it was switched off meanwhile
        first = len(bench.control.writes)
        bench.link.follow(decision(4.0))
        await bench.clock.run_until(50.0)
    assert max(abs(v) for v in bench.control.writes[first][1]) <= 1.0
    assert bench.control.in_force == (0.0, 0.0, 4.0)
    assert len([n for n in bench.notices if "no answer" in n]) == 1


async def test_offsets_stand_still_while_the_nc_probes_and_are_taken_out_of_the_result() -> None:
    bench = Bench("compensate")
    centres = ((1.0, 2.0, 3.0),) * 6
    async with bench.running():
        bench.link.follow(decision(4.0))
        await bench.clock.run_until(10.0)
        cycle = asyncio.create_task(bench.link.measure(Why.INTERVAL))
        await bench.clock.run_until(12.0)
        written = len(bench.control.writes)
        bench.link.follow(decision(9.0))
        await bench.clock.run_until(30.0)
        assert len(bench.control.writes) == written
        bench.control.answer = ProbingStatus(42, ProbingState.DONE, centres)
        await bench.clock.run_until(40.0)
        first = await cycle
        # The first cycle is the reference. The same centres again, with 5 µm more compensated in Z, mean that the
        # sphere has moved by those 5 µm.
        second_cycle = asyncio.create_task(bench.link.measure(Why.INTERVAL))
        await bench.clock.run_until(60.0)
        second = await second_cycle
    assert first.in_force_um == (0.0, 0.0, 4.0)
    assert second.in_force_um == (0.0, 0.0, 9.0)
    assert first.measurement is not None
    assert second.measurement is not None
    np.testing.assert_allclose(first.measurement.errors, 0.0, atol=1e-9)
    moved = np.zeros(9)
    moved[1] = 5.0
    np.testing.assert_allclose(second.measurement.errors, moved, atol=1e-9)
    assert second.number == first.number + 1


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        (ProbingStatus(42, ProbingState.REFUSED, reason="alarm 700016"), "refused.*alarm 700016"),
        (ProbingStatus(42, ProbingState.DONE, ((0.0, 0.0, math.nan),) * 6), "not a finite number"),
        (ProbingStatus(42, ProbingState.DONE, ((0.0, 0.0, 0.0),) * 5), "15 result values, expected 18"),
        (None, "did not end within 900 s"),
    ],
)
async def test_a_cycle_without_a_usable_result_says_why(answer: ProbingStatus | None, reason: str) -> None:
    bench = Bench("compensate")
    bench.control.answer = answer
    async with bench.running():
        await bench.clock.run_until(2.0)
        cycle = asyncio.create_task(bench.link.measure(Why.INTERVAL))
        await bench.clock.run_until(1000.0)
        outcome = await cycle
    assert outcome.measurement is None
    with pytest.raises(AssertionError, match=reason):
        raise AssertionError(outcome.reason)


async def test_a_chip_on_the_sphere_is_no_measurement() -> None:
    bench = Bench("compensate")
    good = np.zeros((6, 3))
    chip = good.copy()
    chip[2] += 0.08  # mm, in one pose only
    async with bench.running():
        await bench.clock.run_until(2.0)
        for centres in (good, chip):
            bench.control.answer = ProbingStatus(0, ProbingState.DONE, tuple(map(tuple, centres)))
            cycle = asyncio.create_task(bench.link.measure(Why.INTERVAL))
            await bench.clock.run_until(bench.clock.monotonic() + 5.0)
            outcome = await cycle
    assert outcome.measurement is None
    assert "is the sphere clean" in outcome.reason


def cycles(centres_um: list[float]) -> dict[int, ProbingStatus]:
    """One cycle after another, its sphere found so far off in Z, in every pose."""
    return {
        41 + n: ProbingStatus(41 + n, ProbingState.DONE, ((0.0, 0.0, z * 1e-3),) * 6) for n, z in enumerate(centres_um)
    }


async def test_the_reference_is_the_mean_of_its_cycles() -> None:
    bench = Bench("compensate")
    bench.control.answers = cycles([3.0, -1.0, 0.0, 2.0, 1.0, 8.0])
    async with bench.running():
        await bench.clock.run_until(2.0)
        reference = asyncio.create_task(bench.link.measure(Why.INTERVAL))
        await bench.clock.run_until(20.0)
        later = asyncio.create_task(bench.link.measure(Why.INTERVAL))
        await bench.clock.run_until(40.0)
    assert bench.control.requests == [41, 42, 43, 44, 45, 46]
    first, second = (await reference).measurement, (await later).measurement
    assert first is not None
    assert second is not None
    np.testing.assert_allclose(first.errors, 0.0, atol=1e-9)
    assert second.errors[1] == pytest.approx(7.0)  # 8 against the mean of the five, 1


async def test_a_reference_is_refused_while_the_machine_moves() -> None:
    bench = Bench("compensate")
    bench.control.answers = cycles([0.0, 6.0, 12.0, 18.0, 24.0])
    async with bench.running():
        await bench.clock.run_until(2.0)
        reference = asyncio.create_task(bench.link.measure(Why.INTERVAL))
        await bench.clock.run_until(20.0)
    outcome = await reference
    assert outcome.measurement is None
    assert "differ by 24.0 µm" in outcome.reason
    assert "at rest" in outcome.reason


async def test_a_cycle_whose_touches_do_not_repeat_is_no_measurement() -> None:
    bench = Bench("compensate")
    bench.control.answer = ProbingStatus(41, ProbingState.DONE, ((0.0, 0.0, 0.0),) * 6, spread_mm=0.030)
    async with bench.running():
        await bench.clock.run_until(2.0)
        cycle = asyncio.create_task(bench.link.measure(Why.INTERVAL))
        await bench.clock.run_until(20.0)
    outcome = await cycle
    assert outcome.measurement is None
    assert outcome.end is End.REJECTED
    assert "repeated touches of a point differ by 30.0 µm" in outcome.reason


async def test_a_result_that_the_prediction_does_not_know_must_be_found_twice() -> None:
    bench = Bench("compensate")
    bench.control.answers = cycles([0.0] * 5 + [20.0, 20.5, 90.0])
    sure = replace(decision(0.0), sigma=np.ones(9), limits=np.full(9, 3.0))
    outcomes = []
    async with bench.running():
        for _ in range(4):
            bench.link.follow(sure)
            cycle = asyncio.create_task(bench.link.measure(Why.INTERVAL))
            await bench.clock.run_until(bench.clock.monotonic() + 20.0)
            outcomes.append(await cycle)
    assert [o.end for o in outcomes] == [End.MEASURED, End.REJECTED, End.MEASURED, End.REJECTED]
    assert "a second cycle must find the same" in outcomes[1].reason
    assert "more than can be believed" in outcomes[3].reason
    assert outcomes[3].centres_mm is not None  # what was rejected is there to be looked at


async def test_a_write_under_way_ends_before_the_offsets_stand_still() -> None:
    bench = Bench("compensate")
    bench.control.answer = ProbingStatus(41, ProbingState.DONE, ((0.0, 0.0, 0.0),) * 6)
    async with bench.running():
        bench.link.follow(decision(20.0))
        await bench.clock.run_until(5.0)
        bench.control.slow = asyncio.Event()
        running = asyncio.create_task(bench.clock.run_until(6.0))
        while not bench.control.in_write:
            await asyncio.sleep(0)
        cycle = asyncio.create_task(bench.link.measure(Why.INTERVAL))
        for _ in range(20):
            await asyncio.sleep(0)
        assert bench.control.requests == []
        bench.control.slow.set()
        await running
        standing = bench.control.in_force
        await bench.clock.run_until(30.0)
        assert (await cycle).in_force_um == standing


async def test_stopping_takes_the_offsets_back() -> None:
    bench = Bench("compensate")
    async with bench.running():
        bench.link.follow(decision(4.0))
        await bench.clock.run_until(10.0)
    stopping = asyncio.create_task(bench.link.stop())
    await bench.clock.run_until(60.0)
    await stopping
    assert bench.control.in_force == (0.0, 0.0, 0.0)


async def test_stopping_takes_the_request_back_that_nobody_waits_for() -> None:
    bench = Bench("monitor")
    async with bench.running():
        await bench.clock.run_until(3.0)
        cycle = asyncio.create_task(bench.link.measure(Why.INTERVAL))
        await bench.clock.run_until(6.0)
        cycle.cancel()
        await asyncio.gather(cycle, return_exceptions=True)
    await bench.link.stop()
    assert bench.control.withdrawn == bench.control.requests == [41]


async def test_what_has_ended_is_not_taken_back() -> None:
    bench = Bench("monitor")
    bench.control.answer = ProbingStatus(41, ProbingState.REFUSED, reason="alarm")
    async with bench.running():
        await bench.clock.run_until(3.0)
        cycle = asyncio.create_task(bench.link.measure(Why.INTERVAL))
        await bench.clock.run_until(6.0)
        await cycle
    await bench.link.stop()
    assert bench.control.withdrawn == []


async def test_a_second_gateway_is_refused_and_the_message_says_so() -> None:
    bench = Bench("compensate")
    bench.control.owner = 99
    async with bench.running():
        bench.link.follow(decision(4.0))
        await bench.clock.run_until(10.0)
        assert bench.control.writes == []
        assert any("belongs to gateway 99" in notice for notice in bench.notices)
        bench.control.owner = 0
        bench.link.follow(decision(4.0))
        await bench.clock.run_until(60.0)
    assert bench.control.in_force == (0.0, 0.0, 4.0)


async def test_a_gateway_that_lost_its_claim_while_running_stops_writing_at_once() -> None:
    bench = Bench("compensate")
    async with bench.running():
        bench.link.follow(decision(4.0))
        await bench.clock.run_until(2.5)
        bench.control.owner = 99
        before = len(bench.control.writes)
        await bench.clock.run_until(20.0)
    assert len(bench.control.writes) == before


async def test_without_a_watchdog_on_the_control_nothing_is_written() -> None:
    bench = Bench("compensate")
    bench.control.watching = False
    async with bench.running():
        bench.link.follow(decision(4.0))
        await bench.clock.run_until(20.0)
    assert bench.control.writes == []
    assert len(bench.control.beats) > 10


async def test_after_the_watchdog_had_the_offsets_it_begins_from_where_they_are() -> None:
    bench = Bench("compensate")
    async with bench.running():
        bench.link.follow(decision(8.0))
        await bench.clock.run_until(15.0)
        bench.control.watching, bench.control.in_force = False, (0.0, 0.0, 2.0)  # ramped while this process hung
        await bench.clock.run_until(17.0)
        bench.control.watching = True
        first = len(bench.control.writes)
        await bench.clock.run_until(20.0)
    assert bench.control.writes[first][1][2] == pytest.approx(3.0)


async def test_stopping_gives_the_control_back() -> None:
    bench = Bench("compensate")
    async with bench.running():
        await bench.clock.run_until(3.0)
        assert bench.control.owner == 1
    stopping = asyncio.create_task(bench.link.stop())
    await bench.clock.run_until(10.0)
    await stopping
    assert bench.control.owner == 0


async def test_what_somebody_else_writes_disarms_instead_of_being_overwritten_by_a_step() -> None:
    bench = Bench("compensate")
    async with bench.running():
        bench.link.follow(decision(4.0))
        await bench.clock.run_until(10.0)
        bench.control.in_force = (0.0, 30.0, 4.0)
        before = len(bench.control.writes)
        bench.link.follow(decision(5.0))
        await bench.clock.run_until(20.0)
    assert len(bench.control.writes) == before
    assert not bench.link.armed
    assert len([notice for notice in bench.notices if "30.00" in notice and "disarmed" in notice]) == 1
