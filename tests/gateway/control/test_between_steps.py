"""What the grid loop hands on as the correction between two steps, from what is read meanwhile."""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from datetime import timedelta
from itertools import pairwise
from typing import Literal

import numpy as np
import pytest

from drivers.base import Quality, Reading
from gateway.config.sections import Probing
from gateway.control.grid import GridSampler, Schedule
from gateway.control.loop import GridLoop
from gateway.control.measuring import Measuring
from gateway.control.trainer import Trainings
from gateway.nc.probing.schedule import schedule_of
from talc.control import Controller
from talc.frame import Decision, FloatArray, Frame, Measurement
from talc.settings import TalcSettings
from tests.benches.kept_events import KeptEvents
from tests.benches.nc_link_bench import LinkBench
from tests.benches.stepped_clock import EPOCH, SteppedClock

STEP_S = 300.0
UM_PER_K = 2.0
READ_EVERY_S = 10
USUAL = 10.0
"""A frame without a good value has 0 in its place, which is then no jump."""


class Between:
    """A grid loop whose learner knows that an error is 2 µm per K of input `a`, which had 10 degC in the last frame."""

    def __init__(self, method: Literal["learner", "models"]) -> None:
        self.told = KeptEvents()
        bench = LinkBench("monitor")
        self.clock: SteppedClock = bench.clock
        self.renewed: list[tuple[float, float]] = []
        """When the correction of the error was renewed, and to what."""
        self.controller = Controller(("a",), TalcSettings(method=method))
        for k in range(100):
            warmer = 4.0 * np.sin(0.2 * k)
            measured = Measurement(UM_PER_K * warmer * np.eye(9)[0], np.full(9, 0.5))
            self.controller.step(Frame(k, np.array([USUAL + warmer]), np.ones(1, dtype=np.bool_), measured))
        self._sampler = GridSampler(("a",), STEP_S)
        plan = schedule_of(Probing(retries=2))
        self.loop = GridLoop(
            self.controller,
            self._sampler,
            Schedule(STEP_S),
            self.clock,
            self.told,
            Measuring(bench.link, plan, Probing(), self.clock, self.told),
            Trainings(self.controller, self.clock, self.told),
            link=self,
        )
        self._next_s = 0.0

    def follow(self, decision: Decision) -> None:
        """The bench only hears what is renewed between two decisions."""

    def renew(self, corrected: FloatArray) -> None:
        """A new correction."""
        assert self.clock.holds == 1, "simulated time stands still meanwhile"
        self.renewed.append((self.clock.monotonic(), float(corrected[0])))

    async def read_until(self, end_s: float, value: Callable[[float], float], quality: Quality = Quality.GOOD) -> None:
        """Read the input each ten seconds until then."""
        while self._next_s < end_s:
            now_s = self._next_s
            await self.clock.run_until(now_s)
            at = EPOCH + timedelta(seconds=now_s)
            self._sampler.add([Reading("a", value(now_s), "degC", quality, at, now_s)])
            self._next_s += READ_EVERY_S
        await self.clock.run_until(end_s)

    def within(self, begin_s: float, end_s: float) -> list[float]:
        return [value for at, value in self.renewed if begin_s < at <= end_s]


@asynccontextmanager
async def between(method: Literal["learner", "models"] = "learner") -> AsyncIterator[Between]:
    rig = Between(method)
    task = asyncio.create_task(rig.loop.run())
    try:
        yield rig
        assert not task.done()
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


def usual(_: float) -> float:
    return USUAL


async def test_the_correction_follows_the_readings() -> None:
    """Nine times per step, from the means of one step's readings; the decision is renewed at the step."""
    async with between() as rig:
        await rig.read_until(STEP_S, usual)
        await rig.read_until(3 * STEP_S, lambda _: USUAL + 4.0)
    assert [at for at, _ in rig.renewed] == [STEP_S + 30.0 * part for part in (*range(1, 10), *range(11, 20))]
    rises = np.diff(rig.within(STEP_S, 2 * STEP_S))
    assert rises[:3] == pytest.approx([2.0] * 3, rel=0.3), "the mean of two fifths of a step rises by 1 K each time"
    assert rises[3:] == pytest.approx([0.0] * 5, abs=0.2), "now by the lags only"


async def test_lags_advance_from_the_last_step() -> None:
    async with between() as rig:
        await rig.read_until(2 * STEP_S + 5.0, usual)
        await rig.read_until(2 * STEP_S + 155.0, lambda _: USUAL + 4.0)
        expected = rig.controller.between(np.array([USUAL + 4.0]), np.ones(1, dtype=np.bool_), 0.5)
        later = rig.controller.between(np.array([USUAL + 4.0]), np.ones(1, dtype=np.bool_), 0.6)
    assert expected is not None
    assert later is not None
    at, renewed = rig.renewed[-1]
    assert at == 2 * STEP_S + 150.0
    assert renewed == pytest.approx(expected[0], rel=1e-9)
    assert renewed != pytest.approx(later[0], rel=1e-9)


async def test_a_sensor_whose_last_readings_are_wrong_moves_it_as_little_as_the_frame_would() -> None:
    """A wire breaks: two readings rise by 12 K before the module notices."""
    async with between() as rig:
        await rig.read_until(STEP_S + 30.0, usual)
        before = rig.told.decisions[-1].corrected[0]
        await rig.read_until(STEP_S + 50.0, lambda _: USUAL + 12.0)
        await rig.read_until(2 * STEP_S - 1.0, usual, Quality.OUT_OF_RANGE)
        moved = np.abs(np.array(rig.within(STEP_S, 2 * STEP_S)) - before)
        await rig.read_until(2 * STEP_S + 1.0, usual, Quality.OUT_OF_RANGE)
    mean_k = 2 * 12.0 / 4
    assert rig.told.frames[-1].inputs[0] == pytest.approx(USUAL + mean_k)
    assert len(moved) == 9
    assert moved.max() < 1.1 * UM_PER_K * mean_k


@pytest.mark.parametrize(
    ("value", "quality"),
    [(USUAL, Quality.STALE), (np.nan, Quality.GOOD), (1e30, Quality.GOOD), (850.0, Quality.GOOD)],
)
async def test_a_missing_or_impossible_input_changes_it_no_more_than_an_input_that_stays(
    value: float, quality: Quality
) -> None:
    async with between() as rig:
        await rig.read_until(STEP_S + 1.0, usual)
        await rig.read_until(2 * STEP_S - 1.0, lambda _: value, quality)
    assert len(rig.within(STEP_S, 2 * STEP_S)) == 9
    assert rig.within(STEP_S, 2 * STEP_S) == pytest.approx([rig.told.decisions[-1].corrected[0]] * 9, abs=0.05)


@pytest.mark.parametrize("jump_s", [-3600.0, 3600.0, 100.0])
async def test_a_clock_that_is_set_changes_neither_when_nor_how_far_it_follows(jump_s: float) -> None:
    """The grid follows the wall clock from the next step on; in between only the monotonic one counts."""
    async with between() as rig:
        await rig.read_until(STEP_S, usual)
        await rig.read_until(STEP_S + 100.0, lambda _: USUAL + 4.0)
        rig.clock.set_utc(rig.clock.utc() + timedelta(seconds=jump_s))
        await rig.read_until(4 * STEP_S, lambda _: USUAL + 4.0)
    frames_s = [STEP_S, 2 * STEP_S]
    assert [at for at, _ in rig.renewed if at < frames_s[1]] == [STEP_S + 30.0 * part for part in range(1, 10)]
    assert len(rig.renewed) == len({at for at, _ in rig.renewed})
    rises = np.diff(rig.within(STEP_S, 2 * STEP_S))
    assert rises[:3] == pytest.approx([2.0] * 3, rel=0.3)
    later = rig.within(2 * STEP_S, 4 * STEP_S)
    assert max(abs(b - a) for a, b in pairwise(later)) < 0.3, "the lags only"


async def test_a_process_that_stood_still_catches_nothing_up() -> None:
    async with between() as rig:
        await rig.read_until(STEP_S + 35.0, usual)
        rig.clock.spend(150.0)
        await rig.clock.run_until(2 * STEP_S + 1.0)
    assert [at for at, _ in rig.renewed] == [STEP_S + after for after in (30.0, 185.0, 210.0, 240.0, 270.0)]


async def test_models_of_the_papers_keep_what_they_decided() -> None:
    async with between("models") as rig:
        await rig.read_until(STEP_S, usual)
        await rig.read_until(2 * STEP_S + 100.0, lambda _: USUAL + 4.0)
    assert len(rig.told.decisions) == 2
    assert rig.renewed == []
