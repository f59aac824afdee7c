"""A dry run on the emulated control: what it shows, what makes it end, and what asks for it."""

import asyncio
import math
import os
import signal
from collections.abc import Callable
from dataclasses import replace

import pytest

from drivers.base import ConnectError, NoAnswer, Refused
from drivers.nc import NcSnapshot, NumericalControl, ProbingState, RequestStatus
from gateway.commissioning.dry_run import until_signal
from gateway.config.sections import Probing
from gateway.model.text import plain
from gateway.nc.probing.cycle import NotBegun, Rejected
from gateway.nc.probing.dry_run import DryRun, run_dry
from gateway.nc.probing.geometry import Geometry, barrier, geometry_of, is_of, recorded
from simulators.nc import Activity, CycleSettings, DayPart, LoadCase, MeanLoads, Nck
from simulators.nc.nck import R_WITHDRAW
from tests.benches.in_process_nc import InProcess
from tests.benches.stepped_clock import SteppedClock
from tests.benches.still_machine import StillMachine
from tests.benches.wire_bench import config

HEIGHT_MM = 50.0
GEOMETRY = Geometry("sinumerik at x", CycleSettings().poses_deg, 120.0, 80.0)


class Dry:
    """A dry run on a control in memory, in stepped time."""

    def __init__(self, driver: Callable[[Nck, SteppedClock], NumericalControl] = InProcess) -> None:
        self.clock = SteppedClock()
        rest = LoadCase([DayPart(0.0, 1e9, Activity.PAUSE, MeanLoads())])
        self.nck = Nck(StillMachine(), rest, cycle=CycleSettings(noise_um=0.0))
        self.nc, self.told = driver(self.nck, self.clock), list[ProbingState]()

    async def begun(
        self, geometry: Geometry = GEOMETRY, timeout_s: float = 900.0, height_mm: float = HEIGHT_MM
    ) -> asyncio.Task[DryRun]:
        await self.nc.connect()
        work = run_dry(
            self.nc,
            7,
            geometry,
            self.clock,
            height_mm=height_mm,
            poll_s=0.5,
            timeout_s=timeout_s,
            told=self.told.append,
        )
        return asyncio.create_task(work)

    async def run(
        self, geometry: Geometry = GEOMETRY, timeout_s: float = 900.0, height_mm: float = HEIGHT_MM
    ) -> DryRun:
        running = await self.begun(geometry, timeout_s, height_mm)
        await self.clock.run_until(self.clock.monotonic() + 1000.0)
        return await running


async def test_the_path_is_seen_above_the_sphere_at_each_pose() -> None:
    dry = Dry()
    done = await dry.run()
    assert (done.wrong, len(done.poses)) == ((), 6)
    assert dry.told == [ProbingState.ACCEPTED, ProbingState.RUNNING, ProbingState.DONE]
    for pose in done.poses:
        assert pose.aside_mm == pytest.approx(0.0, abs=1e-9)
        assert pose.above_mm == pytest.approx(HEIGHT_MM)
        assert pose.nearest_mm == pytest.approx(HEIGHT_MM)
        assert pose.seconds > 5.0
    assert done.ranges["A"] == pytest.approx((-90.0, 90.0))
    assert done.ranges["X"] == pytest.approx((-120.0, 120.0), abs=1.0)
    assert done.seconds == pytest.approx(120.0, abs=2.0)


async def test_a_sphere_elsewhere_than_configured_is_found() -> None:
    farther = await Dry().run(replace(GEOMETRY, radius_mm=155.0))
    assert len(farther.wrong) == 6
    for height_mm in (82.0, 78.0):
        lower = await Dry().run(replace(GEOMETRY, height_mm=height_mm))
        assert len(lower.wrong) == 4, "the poses at which A turns the sphere's height out of Z go past it in Y"


async def test_a_tip_that_is_elsewhere_than_the_origin_says_is_found() -> None:
    """The origin was found with a tool 100 mm shorter: the tip is believed that much higher than it is."""

    class Longer(InProcess):
        async def probing_status(self, number: int) -> RequestStatus:
            status = await super().probing_status(number)
            told = status.centres_mm
            return replace(status, centres_mm=told and tuple((x, y, z + 100.0) for x, y, z in told))

    assert len((await Dry(Longer).run()).wrong) == 6


class Deaf(InProcess):
    """A control that drives the whole cycle, whatever height it was asked for."""

    async def request_probing(self, number: int, dry_run_mm: float = 0.0) -> None:
        await super().request_probing(number)


async def test_a_control_that_goes_down_to_the_sphere_is_told_to_stop_at_once() -> None:
    dry = Dry(Deaf)
    with pytest.raises(Rejected, match="mm from the sphere"):
        await dry.run()
    assert (await dry.nc.probing_status(7)).reason == "withdrawn"
    (begin, end) = dry.nck.cycle.ended[0]
    assert end - begin < 15.0, "at the first pose"


@pytest.mark.parametrize(("height_mm", "limit_mm"), [(30.0, 24.0), (50.0, 40.0), (100.0, 40.0)])
async def test_it_is_withdrawn_nearer_than_40_mm_or_four_fifths_of_a_lower_height(
    height_mm: float, limit_mm: float
) -> None:
    class Lower(InProcess):
        below_mm = height_mm - limit_mm - 0.5

        async def snapshot(self) -> NcSnapshot:
            snapshot = await super().snapshot()
            return replace(snapshot, positions=snapshot.positions | {"Z": snapshot.positions["Z"] - self.below_mm})

    assert (await Dry(Lower).run(height_mm=height_mm)).samples > 0
    Lower.below_mm += 1.0
    with pytest.raises(Rejected, match="mm from the sphere"):
        await Dry(Lower).run(height_mm=height_mm)


async def test_what_does_not_begin_or_end_in_time_is_withdrawn() -> None:
    with pytest.raises(Rejected, match="within 60 s"):
        await Dry().run(timeout_s=60.0)
    dry = Dry()
    dry.nck.cycle.next_safe_point = lambda _: math.inf
    with pytest.raises(NotBegun, match="within 60 s"):
        await dry.run(timeout_s=60.0)
    assert (await dry.nc.probing_status(7)).state is ProbingState.REFUSED


async def test_cancelled_it_is_withdrawn() -> None:
    dry = Dry()
    running = await dry.begun()
    await dry.clock.run_until(40.0)
    assert dry.told[-1] is ProbingState.RUNNING
    running.cancel()
    with pytest.raises(asyncio.CancelledError):
        await running
    assert (await dry.nc.probing_status(7)).state is ProbingState.FAILED


class Cut(InProcess):
    """Its session ends within the dry run; opened again it works, unless it is gone."""

    gone = False

    async def connect(self) -> None:
        if self.gone:
            raise ConnectError("no route to the control", device="nc")
        await super().connect()


@pytest.mark.parametrize("gone", [False, True])
async def test_a_connection_that_breaks_is_made_again_to_withdraw_it(gone: bool) -> None:
    dry = Dry(Cut)
    running = await dry.begun()
    await dry.clock.run_until(40.0)
    assert dry.told[-1] is ProbingState.RUNNING
    assert isinstance(dry.nc, Cut)
    await dry.nc.close()
    dry.nc.gone = gone
    await dry.clock.run_until(60.0)
    with pytest.raises(ConnectError) as raised:
        await running
    assert ("R61 = 7" in raised.value.hint) is gone, "somebody has to stop it at the control"
    dry.nc.gone = False
    await dry.nc.connect()
    assert (await dry.nc.probing_status(7)).state is (ProbingState.RUNNING if gone else ProbingState.FAILED)


class Slow(InProcess):
    """Its answers to a request come after the rest of the test, or never: by then it has begun the cycle."""

    answers = True

    async def request_probing(self, number: int, dry_run_mm: float = 0.0) -> None:
        await super().request_probing(number, dry_run_mm)
        await self._clock.sleep_until(60.0)  # type: ignore[attr-defined]
        if not self.answers:
            raise NoAnswer("no answer within 3 s", device="nc")


@pytest.mark.parametrize(("answers", "raises"), [(True, asyncio.CancelledError), (False, NoAnswer)])
async def test_a_request_that_may_have_been_taken_is_withdrawn(answers: bool, raises: type[BaseException]) -> None:
    dry = Dry(Slow)
    assert isinstance(dry.nc, Slow)
    dry.nc.answers = answers
    running = await dry.begun()
    await dry.clock.run_until(30.0)
    if answers:
        running.cancel()
    await dry.clock.run_until(70.0)
    with pytest.raises(raises):
        await running
    assert (await dry.nc.probing_status(7)).reason == "withdrawn"


async def test_a_request_that_the_control_refuses_is_not_withdrawn() -> None:
    dry = Dry()
    await dry.nc.connect()
    await dry.nc.request_probing(5)
    with pytest.raises(Refused, match="request 5"):
        await dry.run()
    assert dry.nck.r[R_WITHDRAW] == 0.0


@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGTERM, signal.SIGINT])
async def test_a_signal_ends_it_and_the_next_ones_leave_the_withdrawal_alone(number: signal.Signals) -> None:
    dry, withdraws, answered = Dry(), asyncio.Event(), asyncio.Event()

    class Waits(InProcess):
        async def withdraw_probing(self, number: int) -> None:
            withdraws.set()
            await answered.wait()
            await super().withdraw_probing(number)

    dry.nc = Waits(dry.nck, dry.clock)
    await dry.nc.connect()
    before = signal.signal(number, signal.SIG_IGN)  # where nothing handles it, it ends no test either
    work = run_dry(dry.nc, 7, GEOMETRY, dry.clock, height_mm=50.0, poll_s=0.5, timeout_s=900.0, told=dry.told.append)
    running = asyncio.create_task(until_signal(work))
    try:
        await dry.clock.run_until(40.0)
        os.kill(os.getpid(), number)
        async with asyncio.timeout(10.0):
            await withdraws.wait()
            for _ in range(3):
                os.kill(os.getpid(), number)
                await dry.clock.rest()
            answered.set()
            with pytest.raises(Refused, match="withdrawn"):
                await running
    finally:
        answered.set()
        running.cancel()
        asyncio.get_running_loop().remove_signal_handler(number)
        signal.signal(number, before)
    assert (await dry.nc.probing_status(7)).reason == "withdrawn"


def test_another_control_pose_or_sphere_is_another_geometry() -> None:
    others = [
        replace(GEOMETRY, control="sinumerik at y"),
        replace(GEOMETRY, poses_deg=GEOMETRY.poses_deg[:5]),
        replace(GEOMETRY, radius_mm=120.1),
        replace(GEOMETRY, height_mm=-80.0),
        replace(GEOMETRY, channel=2),
        replace(GEOMETRY, origin_mm=(0.0, 0.0, 100.0)),
    ]
    text = recorded(GEOMETRY, "6 poses")
    assert is_of(text, GEOMETRY)
    assert not any(is_of(text, other) for other in others)
    assert not is_of(plain(str(text)), GEOMETRY), "words alone prove nothing"
    same = geometry_of(config())
    assert same == geometry_of(config("monitor"))
    assert same is not None
    assert same.control == "sinumerik at opc.tcp://127.0.0.1:4840"


@pytest.mark.parametrize(
    ("dry_run", "proven", "runs_dry", "stands"),
    [
        ("required", True, False, False),
        ("required", False, True, True),
        ("required", False, None, True),
        ("required", False, False, True),
        ("not offered", False, False, False),
        ("not offered", False, None, True),
        ("not offered", False, True, True),
        ("not offered", True, True, False),
    ],
)
def test_what_stands_against_a_cycle(dry_run: str, proven: bool, runs_dry: bool | None, stands: bool) -> None:
    probing = Probing.model_validate({"dry_run": dry_run})
    assert bool(barrier(probing, proven=proven, runs_dry=runs_dry)) is stands


@pytest.mark.parametrize("runs_dry", [True, False, None])
def test_a_path_that_has_changed_needs_another_dry_run_even_if_the_control_offers_none(runs_dry: bool | None) -> None:
    assert barrier(Probing(), proven=True, runs_dry=runs_dry, same_path=False)
    assert not barrier(Probing(), proven=True, runs_dry=runs_dry, same_path=True)
