"""A restart on a clock that may be wrong: nothing is taken for fresher than it is, and nothing is deleted."""

import math
import shutil
import sqlite3
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from drivers.base import Quality
from gateway.config.file import parse
from gateway.config.model import GatewayConfig
from gateway.config.sections import Probing
from gateway.control.grid import GridSampler, Schedule
from gateway.control.loop import GridLoop
from gateway.control.measuring import Measuring
from gateway.control.restart.earlier import EarlierRun, past_of
from gateway.control.restart.rebuild import controller_of
from gateway.control.trainer import Trainings
from gateway.model.events import DecisionMade, FrameMade, ReadingsTaken
from gateway.model.notice import Notice
from gateway.model.sample import Sample
from gateway.model.step_time import StepTime
from gateway.nc.probing.schedule import schedule_of
from gateway.runtime.ages import Ages
from gateway.service.clock_watch import ClockWatch
from gateway.storage.history import History
from gateway.storage.store import Store
from talc.frame import Decision, Frame, Measurement, Why
from tests.benches.kept_events import KeptEvents
from tests.benches.restarted import replayed, restarted
from tests.benches.service_file import MACHINE, adam6015
from tests.benches.stepped_clock import SteppedClock
from tests.benches.tasks import running

STEP_S = 300.0
FRIDAY = datetime(2026, 3, 27, 16, 0, tzinfo=UTC)
"""When the computer is switched off. On the Sunday after it, summer time begins."""
WEEKEND = timedelta(days=2, hours=14)
STEPS, MEASURED = 20, 10
TEXT = f"""{MACHINE}
[storage]
path = "gateway.sqlite"
""" + adam6015("bed = 0, column = 1")
MONDAY = FRIDAY + WEEKEND


@dataclass(frozen=True)
class Boot:
    """What the wall clock says on Monday morning."""

    wall: datetime
    synchronised: bool = False


BOOTS = {
    "1970": Boot(datetime(1970, 1, 1, tzinfo=UTC)),
    "date of the image": Boot(datetime(2025, 5, 13, tzinfo=UTC)),
    "still Friday": Boot(FRIDAY),
    "8 days behind": Boot(MONDAY - timedelta(days=8)),
    "1 h behind": Boot(MONDAY - timedelta(hours=1)),
    "right, but nobody says so": Boot(MONDAY),
    "daylight saving taken for UTC": Boot(MONDAY + timedelta(hours=2)),
    "1 h ahead": Boot(MONDAY + timedelta(hours=1)),
    "8 days ahead": Boot(MONDAY + timedelta(days=8)),
    "2106": Boot(datetime(2106, 2, 7, tzinfo=UTC)),
    "synchronised": Boot(MONDAY, synchronised=True),
    "synchronised, within a leap second": Boot(MONDAY - timedelta(seconds=1), synchronised=True),
}
QUICK = ("still Friday", "8 days ahead", "2106", "synchronised")


@pytest.fixture(scope="module")
def friday(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The database of a Friday, measured until its last hour."""
    config = parse(TEXT, tmp_path_factory.mktemp("friday") / "gateway.toml")
    controller = controller_of(config)
    last = int(FRIDAY.timestamp() // STEP_S)
    with Store(config.storage.path, "friday", SteppedClock()) as store:
        store.begin(config.canonical(), config.fingerprint(), "")
        store.record(ReadingsTaken([Sample("bed", 20.0, "degC", Quality.GOOD, FRIDAY, 0.0, sequence=1)]))
        for i, k in enumerate(range(last - STEPS + 1, last + 1)):
            x = np.array([20.0 + i / 10.0, 20.0 + np.sin(i / 9.0)])
            measured = i % 5 == 0 and i <= MEASURED
            frame = Frame(k, x, np.ones(2, np.bool_), Measurement(4.0 * x[0] + np.arange(9.0), np.full(9, 0.3)))
            frame = frame if measured else replace(frame, measurement=None)
            store.record(FrameMade(frame, StepTime(k, "friday", 1000.0 + i * STEP_S, 0.0, known=True)))
            store.record(DecisionMade(controller.step(frame)))
    return config.storage.path


@pytest.fixture
def config(friday: Path, tmp_path: Path) -> GatewayConfig:
    """A gateway whose database ends on Friday."""
    config = parse(TEXT, tmp_path / "gateway.toml")
    shutil.copy(friday, config.storage.path)
    return config


def last_k(config: GatewayConfig) -> int:
    with History(config.storage.path) as history:
        k = history.latest_k()
    assert k is not None
    return k


def ages_of(past: EarlierRun, clock: SteppedClock) -> Ages:
    return Ages(clock, STEP_S, past.moment, past.pauses)


def started(boot: Boot) -> SteppedClock:
    clock = SteppedClock()
    clock.is_synchronised = boot.synchronised
    clock.set_utc(boot.wall)
    return clock


class RestartedGrid:
    """A gateway's grid, on a clock, from what the database holds."""

    def __init__(self, config: GatewayConfig, clock: SteppedClock, boot: str) -> None:
        self.config, self.clock, self.boot = config, clock, boot
        self.past = restarted(config)
        self.ages, self.told = ages_of(self.past, clock), KeptEvents()

    async def until(self, *moments: tuple[float, datetime | None]) -> None:
        """Run to each time; there the clock is synchronised with the given one."""
        with Store(self.config.storage.path, self.boot, self.clock) as store:
            store.begin(self.config.canonical(), self.config.fingerprint(), "")

            def sink(event: object) -> None:
                store.record(event)  # type: ignore[arg-type]
                self.told(event)  # type: ignore[arg-type]

            plan = schedule_of(Probing(prefer_idle_s=0.0, insist_after_s=0.0, retries=0, pause_s=0.0))
            loop = GridLoop(
                self.past.controller, GridSampler(self.config.input_names, STEP_S),
                Schedule(STEP_S, self.past.last_k, self.ages.lead_s), self.clock, sink,
                Measuring(None, plan, Probing(), self.clock, sink),
                Trainings(self.past.controller, self.clock, sink), self.ages,
            )  # fmt: skip
            async with running(loop.run()):
                for at_s, right in moments:
                    await self.clock.run_until(at_s)
                    if right is not None:
                        self.clock.set_utc(right)
                        self.clock.is_synchronised = True

    @property
    def frames(self) -> Sequence[Frame]:
        return self.told.frames

    @property
    def decisions(self) -> list[Decision]:
        return [event.decision for event in self.told.of(DecisionMade)]


@pytest.mark.parametrize(
    "boot",
    [pytest.param(boot, id=name, marks=[] if name in QUICK else pytest.mark.slow) for name, boot in BOOTS.items()],
)
async def test_nothing_is_younger_than_it_is_and_nothing_is_deleted(boot: Boot, config: GatewayConfig) -> None:
    before, knows = last_k(config), restarted(config).controller
    measured_k = before - (STEPS - 1 - MEASURED)
    at = RestartedGrid(config, started(boot), "monday")
    weekend_s = WEEKEND.total_seconds()
    assert at.ages.pause_s >= weekend_s - 1.0
    assert -at.ages.monotonic_of(measured_k) >= weekend_s - 1.0 + (STEPS - 1 - MEASURED) * STEP_S
    synchronised_s, end_s = 2.5 * STEP_S, 6.5 * STEP_S
    await at.until((synchronised_s, MONDAY + timedelta(seconds=synchronised_s)), (end_s, None))
    # Until it was synchronised: a learner that knows how long the pause was is no less sure.
    first = at.told.of(FrameMade)[0]
    assert [frame.pause_unknown for frame in at.frames] == [not boot.synchronised, *[False] * (len(at.frames) - 1)]
    assert first.moment is not None
    true_k = before + int((weekend_s - 1.0 + first.moment.monotonic_s) // STEP_S)
    true = knows.step(replace(first.frame, k=true_k, pause_unknown=False))
    assert (at.decisions[0].sigma >= true.sigma - 1e-9).all()
    assert at.decisions[0].measure is not None
    # From then on ages are exact,
    assert at.ages.pause_s == pytest.approx(weekend_s + end_s, abs=1.0)
    assert all(b.k > a.k for a, b in pairwise(at.frames))
    # also after another restart, by the numbering of the steps.
    tuesday = MONDAY + timedelta(days=1, seconds=end_s)
    after = RestartedGrid(config, started(Boot(tuesday, synchronised=True)), "tuesday")
    true_s = (tuesday - FRIDAY).total_seconds()
    ahead_s = (boot.wall - MONDAY).total_seconds() if MONDAY < boot.wall < MONDAY + timedelta(days=30) else 0.0
    assert true_s - 1.0 <= -after.ages.monotonic_of(before) <= true_s + ahead_s + STEP_S
    await after.until((STEP_S, None))
    assert not any(frame.pause_unknown for frame in after.frames)
    assert true_s <= (after.frames[0].k - before) * STEP_S <= true_s + ahead_s + 2 * STEP_S, "2106 is not believed"
    with closing(sqlite3.connect(config.storage.path)) as connection:
        assert connection.execute("SELECT count(*) FROM reading").fetchone() == (1,)
    result = replayed(config.storage.path)
    assert result.steps == STEPS + len(at.frames) + len(after.frames)


async def test_a_clock_that_is_never_synchronised_leaves_the_age_unknown_for_the_next_run_too(
    config: GatewayConfig,
) -> None:
    before = last_k(config)
    at = RestartedGrid(config, started(Boot(FRIDAY)), "monday")
    await at.until((2.5 * STEP_S, None))
    later = RestartedGrid(config, started(Boot(MONDAY + timedelta(days=1), synchronised=True)), "tuesday")
    assert math.isinf(later.ages.pause_s), "nobody knows when the run on Monday was"
    await later.until((1.5 * STEP_S, None))
    assert later.frames[0].pause_unknown
    assert last_k(config) == int((MONDAY + timedelta(days=1)).timestamp() // STEP_S) + 1
    same_day = RestartedGrid(config, started(Boot(MONDAY + timedelta(days=1, hours=1), synchronised=True)), "at noon")
    assert same_day.ages.monotonic_of(before) == -math.inf
    assert same_day.ages.monotonic_of(later.frames[0].k) == pytest.approx(-3600.0, abs=STEP_S)


def test_a_synchronised_clock_before_the_last_step_tells_no_age(config: GatewayConfig) -> None:
    """One of the two time servers was wrong, and nobody knows which."""
    past = restarted(config)
    ages = ages_of(past, started(Boot(FRIDAY - timedelta(hours=1), synchronised=True)))
    assert math.isinf(ages.pause_s)
    assert ages.monotonic_of(past.last_k) == -math.inf


async def test_a_restart_of_the_service_alone_needs_no_wall_clock(config: GatewayConfig) -> None:
    before = last_k(config)
    at = RestartedGrid(config, started(Boot(FRIDAY)), "monday")
    await at.until((1.5 * STEP_S, None))
    clock = started(Boot(datetime(1980, 1, 1, tzinfo=UTC)))
    clock.started_as = at.clock.started_as
    clock.spend(1.5 * STEP_S + 40 * STEP_S)
    again = RestartedGrid(config, clock, "monday again")
    first_k, moment = at.frames[0].k, again.past.moment
    assert moment is not None
    assert again.ages.pause_s == pytest.approx(clock.monotonic() - moment.monotonic_s)
    assert clock.monotonic() - again.ages.monotonic_of(first_k) >= 40 * STEP_S
    assert again.ages.monotonic_of(before) == -math.inf, "the weekend is still unknown"
    await again.until((43 * STEP_S, MONDAY + timedelta(seconds=43 * STEP_S)), (45 * STEP_S, None))
    assert not any(frame.pause_unknown for frame in again.frames)
    after = RestartedGrid(config, started(Boot(MONDAY + timedelta(seconds=45 * STEP_S), synchronised=True)), "later")
    true_s = WEEKEND.total_seconds() + 45 * STEP_S
    assert true_s - 1.0 <= after.clock.monotonic() - after.ages.monotonic_of(before) <= true_s + 2 * STEP_S


async def test_a_pause_after_a_clock_that_was_ahead_is_no_shorter_than_it_is(config: GatewayConfig) -> None:
    at = RestartedGrid(config, started(Boot(MONDAY + timedelta(days=8))), "ahead")
    await at.until((1.5 * STEP_S, None))
    clock = started(Boot(MONDAY, synchronised=True))
    clock.started_as = at.clock.started_as
    clock.spend(41.5 * STEP_S)
    again = RestartedGrid(config, clock, "right")
    await again.until((43 * STEP_S, None))
    assert 41 <= again.frames[0].k - at.frames[0].k <= 42


async def test_a_clock_that_is_set_before_the_first_step_ends_leaves_nothing_unknown(config: GatewayConfig) -> None:
    at = RestartedGrid(config, started(Boot(FRIDAY)), "monday")
    await at.until((30.0, MONDAY + timedelta(seconds=30.0)), (3.5 * STEP_S, None))
    assert not any(frame.pause_unknown for frame in at.frames)
    assert at.frames[0].k == int(MONDAY.timestamp() // STEP_S) + 2


async def test_an_impossible_year_is_not_believed_until_it_is_synchronised() -> None:
    schedule = Schedule(STEP_S, 1000)
    assert schedule.next(datetime(2106, 1, 1, tzinfo=UTC), 0.0, known=False).k == 1001
    assert schedule.next(datetime(2106, 1, 1, tzinfo=UTC), 400.0, known=True).k > 10_000_000


async def test_the_clock_is_reported_until_it_is_synchronised_and_the_pause_then(config: GatewayConfig) -> None:
    clock, notices, known = started(Boot(FRIDAY)), list[Notice](), list[float]()
    clock.spend(42.0)
    ages = ages_of(restarted(config), clock)
    watch = ClockWatch(ages, clock, notices.append, lambda: known.append(ages.pause_s))
    async with running(watch.run()):
        await clock.run_until(100.0)
        before = watch.unknown
        clock.set_utc(MONDAY + timedelta(seconds=100.0))
        clock.is_synchronised = True
        await clock.run_until(200.0)
        clock.is_synchronised = False  # the line to the server is lost: the quartz goes on
        await clock.run_until(300.0)
    assert (before, watch.unknown) == (True, False)
    (began, ended) = notices
    assert "not synchronised" in began.text
    assert "at least 0:00:42" in began.text
    assert (ended.text, ended.ended) == ("clock: synchronised; the last stored step was 2 days, 14:01:42 ago", True)
    assert known == [pytest.approx(WEEKEND.total_seconds() + 102.0)]


async def test_a_computer_whose_clock_is_right_says_nothing(config: GatewayConfig) -> None:
    clock, notices = started(Boot(MONDAY, synchronised=True)), list[Notice]()
    ages = ages_of(restarted(config), clock)
    watch = ClockWatch(ages, clock, notices.append, lambda: pytest.fail("was known before"))
    async with running(watch.run()):
        await clock.run_until(100.0)
    assert notices == []


def test_a_pause_of_unknown_length_makes_a_measurement_wanted_whatever_the_policy(config: GatewayConfig) -> None:
    for method in ("policy = 'fixed'\nmeasurement_interval_steps = 500", "policy = 'uncertainty'\nlimit_um = 50.0"):
        other = parse(f"{TEXT}\n[talc.learner]\n{method}\n", config.storage.path)
        wanted = []
        for unknown in (False, True):
            with History(config.storage.path) as history:
                controller = past_of(history, other).controller
            frame = Frame(last_k(config) + 1, np.full(2, 21.0), np.ones(2, np.bool_), pause_unknown=unknown)
            wanted.append(controller.step(frame).measure)
        assert wanted[1] in (Why.INTERVAL, Why.NOVELTY)
        assert wanted[0] is None


def test_a_wall_clock_that_is_set_is_right_no_longer_until_it_is_synchronised(config: GatewayConfig) -> None:
    clock = started(Boot(MONDAY, synchronised=True))
    ages = ages_of(restarted(config), clock)

    def known(*, synchronised: bool) -> bool:
        clock.is_synchronised = synchronised
        return ages.known

    assert known(synchronised=True)
    assert known(synchronised=False), "quartz is enough"
    clock.set_utc(MONDAY + timedelta(seconds=156))
    assert [known(synchronised=now) for now in (False, False, True)] == [False, False, True]
