"""The command `reference`: the sphere was moved, and errors count from where it is now."""

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from drivers.nc import ProbingState, ProgramState, RequestStatus, Triple
from gateway.config.file import parse
from gateway.model.commands import CommandName
from gateway.model.events import FrameMade, MeasurementEnded
from gateway.model.standing import Standing
from gateway.storage.mending import Known, mend
from gateway.storage.rows import of_outcome
from gateway.storage.store import Store
from talc.frame import Why
from tests.benches.commanded import CONFIG, STEP_S, Commanded, commanded
from tests.benches.kept_events import KeptEvents
from tests.benches.nc_link_bench import LinkBench
from tests.benches.restarted import replayed, restarted
from tests.benches.stepped_clock import EPOCH, SteppedClock

REFERENCE, MEASURE, DISARM = CommandName.REFERENCE, CommandName.MEASURE, CommandName.DISARM
LEARNER = CONFIG.replace('method = "models"', 'method = "learner"')


def found_at(z_mm: float, x_mm: float = 0.0) -> RequestStatus:
    """The sphere's centres, all moved alike: at A = 0 that is EZ0A, and a sphere that was moved."""
    centre: Triple = (x_mm, 0.0, z_mm)
    return RequestStatus(0, ProbingState.DONE, (centre,) * 6)


def stored(told: KeptEvents, path: Path, *, until: int | None = None) -> None:
    """Store what a gateway told, or only the first so many events."""
    clock = SteppedClock()
    with Store(path, "boot", clock) as store:
        config = parse(LEARNER, path.parent / "gateway.toml")
        store.begin(config.canonical(), config.fingerprint(), "")
        for event in told.all[:until]:
            if isinstance(event, MeasurementEnded):
                clock.set_utc(event.outcome.ended)
            if isinstance(event, FrameMade):
                clock.set_utc(datetime.fromtimestamp(event.frame.k * STEP_S, UTC))
            store.record(event)


async def begun(at: Commanded) -> None:
    """The first step has measured the first reference."""
    await at.bench.clock.run_until(10.0)
    await at.give(MEASURE)
    await at.bench.clock.run_until(STEP_S + 1.0)


@pytest.fixture
def bench() -> LinkBench:
    bench = LinkBench("compensate", shipped=True)
    bench.control.answer = found_at(0.0)
    return bench


async def test_errors_count_from_the_new_reference_and_the_offsets_go_there(bench: LinkBench, tmp_path: Path) -> None:
    async with commanded(bench, method="learner") as at:
        await begun(at)
        bench.control.answer = found_at(-0.012)  # the machine has moved
        for step in (2, 3):  # so far that a second cycle has to confirm it
            await at.give(MEASURE)
            await bench.clock.run_until(step * STEP_S + 1.0)
        await bench.clock.run_until(4 * STEP_S)
        moved = bench.control.in_force[2]
        assert abs(moved) == pytest.approx(12.0, abs=2.0)
        many = len(bench.control.requests)
        bench.control.program, bench.control.speed = ProgramState.RUNNING, 8000.0
        bench.control.answer = found_at(3.0, x_mm=-2.0)  # and somebody the sphere
        answer = await at.give(REFERENCE)
        assert (answer.accepted, answer.text) == (
            True,
            "the reference is dropped; the sphere is measured anew as soon as no program runs, and from then on errors"
            " count from zero and the offsets go there",
        )
        await bench.clock.run_until(11 * STEP_S)
        assert len(bench.control.requests) == many, "a program runs, and its part counts on the offsets"
        assert bench.control.in_force[2] == pytest.approx(moved, abs=1.0), "the machine is as it was"
        assert at.told.outlooks[-1].standing is Standing.WAITING
        assert "30 min" in at.told.outlooks[-1].operator
        bench.control.program, bench.control.speed = ProgramState.ABORTED, 0.0
        await bench.clock.run_until(12 * STEP_S - 30.0)
        assert len(bench.control.requests) == many + 5, "a reference is the mean of five"
        assert bench.control.in_force[2] == pytest.approx(moved, abs=1.0)
        await bench.clock.run_until(13 * STEP_S)
        assert bench.control.in_force == pytest.approx((0.0, 0.0, 0.0), abs=0.5)
        assert at.largest_step_um() <= 1.0
        [frame] = [frame for frame in at.told.frames if frame.new_reference]
        assert frame.measurement is not None
        np.testing.assert_allclose(frame.measurement.errors, 0.0, atol=1e-9)
        bench.control.answer = found_at(2.997 + (moved - bench.control.in_force[2]) * 1e-3, x_mm=-2.0)
        await at.give(MEASURE)
        await bench.clock.run_until(14 * STEP_S)
        latest = at.told.frames[-1].measurement
        assert latest is not None
        assert not at.told.frames[-1].new_reference
        assert abs(latest.errors).max() == pytest.approx(3.0, abs=0.5), "since the new reference"

    config = parse(LEARNER, tmp_path / "gateway.toml")
    stored(at.told, config.storage.path)
    replayed(config.storage.path)
    past = restarted(config)
    assert past.reference_mm is not None
    assert not past.renewing
    np.testing.assert_allclose(past.reference_mm, [[-2.0, 0.0, 3.0 + moved * 1e-3]] * 6, atol=2e-3)


async def test_a_cycle_that_ran_when_the_reference_was_dropped_counts_for_neither(bench: LinkBench) -> None:
    async with commanded(bench, method="learner") as at:
        await begun(at)
        bench.control.answer = None  # it runs on
        await at.give(MEASURE)
        await bench.clock.run_until(2 * STEP_S - 100.0)
        assert bench.control.requests[5:] == [46]
        assert (await at.give(REFERENCE)).accepted
        bench.control.answer = found_at(1.0)
        await bench.clock.run_until(3 * STEP_S + 1.0)
        first, second, third = at.told.outcomes[-3:]
        assert (first.why, first.measurement) == (Why.REFERENCE, None), "what was dropped"
        assert (second.measurement, second.reason) == (None, "the reference was dropped while the cycle ran")
        assert third.why is Why.REFERENCE
        assert third.measurement is not None
        assert [frame.new_reference for frame in at.told.frames] == [False, False, True]


async def test_a_dropped_reference_stays_dropped_until_a_step_has_the_new_one(bench: LinkBench, tmp_path: Path) -> None:
    async with commanded(bench, method="learner") as at:
        await begun(at)
        await at.give(REFERENCE)
        await bench.clock.run_until(2 * STEP_S + 1.0)
    config = parse(LEARNER, tmp_path / "gateway.toml")
    path, events = config.storage.path, at.told.all
    ended = [i for i, event in enumerate(events) if isinstance(event, MeasurementEnded)]
    frames = [i for i, event in enumerate(events) if isinstance(event, FrameMade)]
    assert len(ended) == 3
    assert ended[-1] < frames[-1]
    for until, renewing in ((ended[0] + 1, False), (ended[1] + 1, True), (frames[-1], True), (None, False)):
        path.unlink(missing_ok=True)
        stored(at.told, path, until=until)
        past = restarted(config)
        assert (past.renewing, past.reference_mm is None) == (renewing, renewing), until
        mend(path, "a bit has flipped", EPOCH, Known())
        assert restarted(config).renewing is renewing
    again = LinkBench("compensate")
    again.control.answer = found_at(0.5)
    async with commanded(again, method="learner", anew=True) as at:
        await again.clock.run_until(STEP_S + 1.0)
        assert [outcome.why for outcome in at.told.outcomes] == [Why.REFERENCE]
        assert at.told.frames[0].new_reference


async def test_what_a_repair_lost_of_the_reference_is_put_back(bench: LinkBench, tmp_path: Path) -> None:
    async with commanded(bench, method="learner") as at:
        await begun(at)
        await at.give(REFERENCE)
        await bench.clock.run_until(2 * STEP_S + 1.0)
    config = parse(LEARNER, tmp_path / "gateway.toml")
    path = config.storage.path
    first, dropped, anew = at.told.of(MeasurementEnded)
    for lost, reads in ((dropped, first), (anew, dropped)):
        path.unlink(missing_ok=True)
        told = KeptEvents()
        told.all = [event for event in at.told.all if event is not lost and event is not anew]
        stored(told, path)
        assert restarted(config).renewing is (reads is dropped)
        mend(path, "a bit has flipped", EPOCH, Known(reference=of_outcome(lost.outcome)))
        assert restarted(config).renewing is (lost is dropped)


async def test_without_a_reference_or_without_probing_nothing_is_dropped(bench: LinkBench) -> None:
    async with commanded(bench, method="learner") as at:
        await bench.clock.run_until(10.0)
        assert (await at.give(REFERENCE)).text == "there is no reference at present; the next measurement sets it"
        await at.give(DISARM)
        refused = await at.give(REFERENCE)
        assert (refused.accepted, at.told.outcomes) == (False, [])
