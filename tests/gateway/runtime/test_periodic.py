"""When the periods of a poller begin, and which are skipped."""

import asyncio
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager

import pytest

from gateway.runtime.periodic import Periodic
from tests.benches.stepped_clock import SteppedClock


class Worker:
    """Notes when it was asked to work; takes the given times, then none."""

    def __init__(self, clock: SteppedClock, takes_s: Sequence[float] = ()) -> None:
        self.clock, self.takes_s = clock, list(takes_s)
        self.due_s: list[float] = []
        self.began_s: list[float] = []
        self.skipped: list[int] = []

    async def work(self, due_s: float) -> None:
        assert self.clock.holds == 1, "simulated time runs during the work"
        self.due_s.append(due_s)
        self.began_s.append(self.clock.monotonic())
        self.clock.spend(self.takes_s.pop(0) if self.takes_s else 0.0)


@asynccontextmanager
async def running(periodic: Periodic, worker: Worker) -> AsyncIterator[None]:
    task = asyncio.create_task(periodic.run(worker.work, worker.skipped.append))
    try:
        yield
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


async def test_periods_do_not_drift_by_what_their_work_takes() -> None:
    clock = SteppedClock()
    worker = Worker(clock, [0.3] * 5)
    async with running(Periodic(clock, 1.0), worker):
        await clock.run_until(5.5)
    assert worker.began_s == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    assert worker.skipped == [0] * 6


async def test_periods_that_pass_during_the_work_are_skipped_and_counted() -> None:
    clock = SteppedClock()
    worker, periodic = Worker(clock, [0.0, 3.4]), Periodic(clock, 1.0)
    async with running(periodic, worker):
        await clock.run_until(7.5)
    # The work of 1 ends at 4.4: 2, 3 and 4 are skipped, and 5 begins when it is due.
    assert worker.due_s == worker.began_s == [0.0, 1.0, 5.0, 6.0, 7.0]
    assert worker.skipped == [0, 3, 0, 0, 0]
    assert periodic.missed == 3


async def test_work_of_exactly_a_period_skips_none() -> None:
    clock = SteppedClock()
    worker, periodic = Worker(clock, [1.0, 1.0]), Periodic(clock, 1.0)
    async with running(periodic, worker):
        await clock.run_until(3.5)
    assert worker.began_s == [0.0, 1.0, 2.0, 3.0]
    assert periodic.missed == 0


@pytest.mark.parametrize(
    ("takes_s", "second_s", "missed"),
    [(0.0, 0.25, 0), (0.2, 0.25, 0), (0.25, 0.25, 0), (0.9, 1.25, 0), (1.2, 1.25, 0), (1.3, 2.25, 1)],
)
async def test_a_phase_shifts_all_but_the_first_period(takes_s: float, second_s: float, missed: int) -> None:
    clock = SteppedClock()
    worker, periodic = Worker(clock, [takes_s]), Periodic(clock, 1.0, phase_s=0.25)
    async with running(periodic, worker):
        await clock.run_until(3.5)
    assert worker.due_s[:2] == [0.0, second_s]
    assert all(due % 1.0 == 0.25 for due in worker.due_s[1:])
    assert periodic.missed == missed


async def test_the_first_period_begins_when_it_is_told_to() -> None:
    clock = SteppedClock()
    worker = Worker(clock)
    async with running(Periodic(clock, 1.0, first_s=2.5), worker):
        await clock.run_until(4.6)
    assert worker.began_s == [2.5, 3.5, 4.5]


@pytest.mark.parametrize(("period_s", "phase_s"), [(0.0, 0.0), (1.0, 1.0), (1.0, -0.1)])
async def test_invalid_periods_are_refused(period_s: float, phase_s: float) -> None:
    with pytest.raises(ValueError, match="expected 0 <= phase < period"):
        Periodic(SteppedClock(), period_s, phase_s=phase_s)
