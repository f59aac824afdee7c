"""The residual thermal error at the tool, for each route by which offsets reach the control.

The machine is a warm, moving one of the simulators; the errors are known exactly, so that only the routes differ.
"""

import asyncio
import itertools
from collections import deque
from collections.abc import AsyncIterator, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import replace

import numpy as np
import pytest

from drivers.sinumerik.make import make_sinumerik
from drivers.sinumerik.programs import ErrorTerms, errors_program
from drivers.sinumerik.settings import PAIRS, OffsetRoute, SinumerikSettings
from gateway.config.extended import validate
from gateway.nc.link import NcLink
from gateway.nc.settings import Earlier, Identity, LinkSettings, Listeners
from simulators.nc import (
    Activity,
    CycleSettings,
    DayPart,
    EmulatedControl,
    LoadCase,
    MachineState,
    MachineUnderControl,
    MeanLoads,
)
from simulators.nc.nck import CEC_TABLES
from simulators.nc.nine_errors import R_COUNT_WITH_ERRORS
from simulators.plant import RADIUS_MM, Environment, MachineDrive, Plant, load_machine
from talc.frame import Decision, FloatArray, Phase, Why
from tests.benches.wire_clock import WireClock

pytestmark = pytest.mark.slow

WARM_S = 6 * 3600.0
SETTLED_S, END_S, SAMPLE_S = 90.0, 150.0, 0.5
BOUND_UM, SLEW_UM_PER_S = 300.0, 5.0
LESS_THAN_A_PERIOD_S = 0.98
TRAVEL = ((-150.0, 150.0), (-150.0, 150.0), (50.0, 250.0))
"""The travel that the emulated control's program covers."""
NAMES = {pair: name for name, pair in PAIRS.items()}
TABLES = {NAMES[pair]: number for number, pair in enumerate(CEC_TABLES)}
PLAIN = OffsetRoute()
OWN_AXES = OffsetRoute(route="k0_slope", travel_mm=TRAVEL)
NINE = OffsetRoute(route="errors", travel_mm=TRAVEL)
EVERY_PAIR = OffsetRoute(route="k0_slope", travel_mm=TRAVEL, tables=TABLES)


class WarmMachine:
    """The plant after a long day, at a fixed time; `ideal` while it is to have no errors."""

    def __init__(self) -> None:
        self.ideal = False
        self.plant = Plant(load_machine(), Environment(), seed=3)
        self.plant.advance(3600.0, MachineDrive())
        self.plant.zero()
        drive = MachineDrive(speed_x=4000.0, speed_y=4000.0, speed_z=2000.0, speed_c=400.0, spindle_speed=12000.0)
        self.plant.advance(3600.0 + WARM_S, drive)

    def tool_deviation_um(
        self, time_s: float, x_mm: float, y_mm: float, z_mm: float, a_deg: float, c_deg: float
    ) -> tuple[float, float, float]:
        deviation = self.plant.deviation_um(x_mm, y_mm, z_mm, a_deg, c_deg) * (not self.ideal)
        x, y, z = (float(v) for v in deviation)
        return x, y, z


@pytest.fixture(scope="module")
def machine() -> WarmMachine:
    return WarmMachine()


def settings_of(url: str, compensation: OffsetRoute) -> SinumerikSettings:
    # In real time: on a busy computer an answer may be late, and the library asks by itself whether the server lives.
    return SinumerikSettings(security="none", url=url, origin_tool_mm=0.0, compensation=compensation, timeout_s=60.0)


def programs(compensation: OffsetRoute) -> list[str]:
    """What the control runs for a route: the generated program, or the emulated control's own watchdog."""
    if compensation.route != "errors":
        return []
    terms = ErrorTerms(SLEW_UM_PER_S, RADIUS_MM, (BOUND_UM,) * 3)
    return [errors_program(settings_of("opc.tcp://nc", compensation), terms)]


def perfect(machine: WarmMachine) -> Decision:
    errors, sigma, limits = machine.plant.errors(), np.ones(9), np.full(9, 5.0)
    return Decision(1, Phase.COMPENSATION, errors, errors, sigma, limits, None, None, ())


class ShiftRecorder(EmulatedControl):
    """Notes the shift in every corner of the travel at each read, write and look; it can make the caller hang."""

    hang_in: int | None = None
    """The gateway stands still before it gets the answer to the request that comes after this many."""
    hang_s = 0.0
    hung = 0

    def __init__(
        self,
        machine: MachineUnderControl,
        clock: WireClock,
        program: LoadCase,
        cycle: CycleSettings,
        compensation: OffsetRoute,
    ) -> None:
        self.corners: list[tuple[float, FloatArray]] = []
        self.requests: list[str] = []
        self._stepped, self._is_read = clock, False
        super().__init__(
            machine, clock, program, cycle=cycle, programs=programs(compensation), r_count=R_COUNT_WITH_ERRORS
        )
        self.before_read = self._asked

    def now(self) -> float:
        now = super().now()
        self.note()
        return now

    async def _asked(self, _: Sequence[str]) -> None:
        self._is_read = True

    def state(self) -> MachineState:
        state = super().state()
        if self._is_read:  # otherwise it is the control itself that looks
            self._is_read = False
            self._answers("read")
        return state

    def wake(self) -> None:
        self.note()
        super().wake()
        self._answers("write")

    def _answers(self, request: str) -> None:
        self.requests.append(request)
        if self.hang_in is not None:
            self.hang_in -= 1
            if self.hang_in < 0:
                self._stepped.spend(self.hang_s)
                self.hang_in, self.hung = None, self.hung + 1

    def note(self) -> None:
        shifts = np.array([self.nck.shift_um(corner) for corner in itertools.product(*TRAVEL)])
        self.corners.append((self._stepped.monotonic(), shifts))

    def largest_step_um(self) -> float:
        """The largest change anywhere within less than a period, in which there is one write at most."""
        largest, recent = 0.0, deque[tuple[float, FloatArray]]()
        for now, shifts in self.corners:
            while recent and now - recent[0][0] > LESS_THAN_A_PERIOD_S:
                recent.popleft()
            largest = max([largest, *(float(np.abs(shifts - before).max()) for _, before in recent)])
            recent.append((now, shifts))
        return largest


@asynccontextmanager
async def moving(
    machine: WarmMachine, compensation: OffsetRoute = PLAIN
) -> AsyncIterator[tuple[ShiftRecorder, WireClock, str]]:
    clock = WireClock()
    loads = MeanLoads(x=1500.0, y=1100.0, z=700.0, a=0.1, c=20.0, spindle=6000.0)
    cycle = CycleSettings(radius_mm=RADIUS_MM, noise_um=0.0)
    control = ShiftRecorder(
        machine, clock, LoadCase([DayPart(0.0, 1e6, Activity.FINISHING, loads)]), cycle, compensation
    )
    url = await control.start()
    try:
        yield control, clock, url
    finally:
        await control.stop()


@asynccontextmanager
async def linked(
    machine: WarmMachine, clock: WireClock, url: str, compensation: OffsetRoute
) -> AsyncIterator[tuple[NcLink, list[str]]]:
    """The gateway's link at work with the machine's errors known; and the problems that it reports."""
    config = validate(
        {
            "machine": {"name": "mill"},
            "nc": {"kind": "sinumerik", "url": url, "security": "none"},
            "probing": {"armed": True, "sphere_radius_mm": RADIUS_MM, "reference_cycles": 1},
            "compensation": {
                "mode": "compensate", "bound_um": [BOUND_UM] * 3, "slew_um_per_s": SLEW_UM_PER_S,
                "stale_after_s": 4000.0,
            },
        }
    )  # fmt: skip
    problems: list[str] = []
    nc = make_sinumerik(settings_of(url, compensation), clock)
    link = NcLink(
        nc,
        clock,
        LinkSettings.of(config, Identity()),
        Earlier(first_number=1),
        Listeners(notify=lambda notice: problems.append(notice.text)),
    )
    link.follow(perfect(machine))
    task = asyncio.create_task(link.run())
    try:
        yield link, problems
    finally:
        ended = task.done()
        task.cancel()
        [error] = await asyncio.gather(task, return_exceptions=True)
        await nc.close()
        assert not ended, error


def left_um(machine: WarmMachine, control: EmulatedControl, now: float) -> FloatArray:
    """(3,) deviation at the tool."""
    control.nck.advance(now)
    at = control.nck.state(now).positions
    x, y, z, a, c = (at[axis] for axis in "XYZAC")
    return np.subtract(machine.tool_deviation_um(now, x, y, z, a, c), control.nck.shift_um((x, y, z)))


async def rms_um(machine: WarmMachine, compensation: OffsetRoute | None) -> FloatArray:
    """(3,) RMS of X, Y, Z over some minutes of moving, after the ramp; None: not compensated."""
    async with AsyncExitStack() as stack:
        control, clock, url = await stack.enter_async_context(moving(machine, compensation or PLAIN))
        if compensation is not None:
            link, problems = await stack.enter_async_context(linked(machine, clock, url, compensation))
        found = []
        for now in np.arange(0.0, END_S, SAMPLE_S):
            await clock.run_until(now)
            if now >= SETTLED_S:
                found.append(left_um(machine, control, now))
        if compensation is not None:
            assert link.armed
            assert problems == []
        rms: FloatArray = np.sqrt(np.mean(np.square(found), axis=0))
        return rms


async def test_the_error_at_the_tool_falls_and_the_more_the_control_follows_by_itself(machine: WarmMachine) -> None:
    none = await rms_um(machine, None)
    once_per_second = await rms_um(machine, PLAIN)
    own_axes = await rms_um(machine, OWN_AXES)
    every_pair = await rms_um(machine, EVERY_PAIR)
    nine = await rms_um(machine, NINE)
    assert none.min() > 5.0, "a machine without errors shows nothing"
    assert (once_per_second < 0.1 * none).all()
    assert (own_axes < once_per_second).all()
    assert (every_pair < 0.5 * own_axes).all()
    assert (every_pair < 0.1).all()
    assert (nine < 0.01).all(), "the control follows A too, and in each of its own cycles"


async def test_nowhere_in_the_travel_does_a_write_make_a_step_or_pass_the_bound(machine: WarmMachine) -> None:
    corners = list(itertools.product(*TRAVEL))
    async with moving(machine) as (control, clock, url), linked(machine, clock, url, EVERY_PAIR) as (link, _):
        before = np.zeros((8, 3))
        for now in np.arange(1.0, 200.0):
            if now == 60.0:
                link.follow(replace(perfect(machine), corrected=-8.0 * machine.plant.errors()))
            await clock.run_until(now)
            after = np.array([control.nck.shift_um(corner) for corner in corners])
            assert np.abs(after - before).max() <= SLEW_UM_PER_S * 1.0 + 1e-6
            assert np.abs(after).max() <= BOUND_UM + 1e-6
            before = after
    assert np.abs(before).max() > 0.5 * BOUND_UM


@pytest.mark.parametrize(
    ("compensation", "hang_s"),
    [(EVERY_PAIR, 0.95), (PLAIN, 14.0)],
    ids=["k0_slope-for less than a period", "k0-for longer than watchdog_s"],
)
async def test_a_process_that_stands_still_within_any_request_leaves_no_step_behind(
    machine: WarmMachine, compensation: OffsetRoute, hang_s: float
) -> None:
    async with moving(machine) as (control, clock, url), linked(machine, clock, url, compensation) as (link, problems):
        await clock.run_until(30.5)
        before = len(control.requests)
        await clock.run_until(31.5)
        of_a_period = control.requests[before:]
        assert of_a_period.count("write") == 2, "the heartbeat and the offsets"
        assert of_a_period.count("read") >= 3, "the owner, and what is in force before and after the write"
        for number in range(len(of_a_period)):
            link.follow(replace(perfect(machine), corrected=(-1) ** number * 8.0 * machine.plant.errors()))
            await clock.run_until(clock.monotonic() + 10.0)
            control.hang_in, control.hang_s = number, hang_s
            await clock.run_until(clock.monotonic() + 50.0)
        assert control.hung == len(of_a_period)
        assert link.armed, problems
        assert control.largest_step_um() <= SLEW_UM_PER_S * 1.0 + 1e-6
        assert np.abs(control.corners[-1][1]).max() > 10.0, "an offset of zero cannot step"


@pytest.mark.parametrize("what", ["slope", "k0_mm"])
async def test_what_somebody_else_writes_disarms(machine: WarmMachine, what: str) -> None:
    async with moving(machine) as (control, clock, url), linked(machine, clock, url, EVERY_PAIR) as (link, problems):
        await clock.run_until(30.0)
        armed = [link.armed]
        getattr(control.nck, what)[1] += 0.001
        await clock.run_until(32.0)
        armed.append(link.armed)
        assert armed == [True, False]
        assert [text for text in problems if "disarmed" in text]


@pytest.mark.parametrize("compensation", [EVERY_PAIR], ids=["k0_slope"])
async def test_what_is_in_force_is_taken_out_of_what_is_probed(machine: WarmMachine, compensation: OffsetRoute) -> None:
    async with (
        moving(machine, compensation) as (_, clock, url),
        linked(machine, clock, url, compensation) as (link, problems),
    ):
        machine.ideal = True
        link.follow(replace(perfect(machine), corrected=np.zeros(9)))
        await clock.run_until(2.0)
        first = asyncio.create_task(link.measure(Why.INTERVAL))
        await clock.run_until(300.0)
        machine.ideal = False
        link.follow(perfect(machine))
        await clock.run_until(400.0)
        second = asyncio.create_task(link.measure(Why.INTERVAL))
        await clock.run_until(700.0)
        reference, found = await first, await second
    assert problems == []
    assert reference.measurement is not None
    assert found.measurement is not None
    assert np.abs(np.asarray(found.in_force_um)).max() > 40.0
    if compensation is EVERY_PAIR:
        assert np.ptp(np.asarray(found.in_force_um), axis=0).max() > 5.0, "another shift at each pose"
    np.testing.assert_allclose(found.measurement.errors, machine.plant.errors(), atol=0.05)
