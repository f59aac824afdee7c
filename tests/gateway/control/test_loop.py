"""The grid loop between controller, schedule and NC: its requests and its reports."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.nc import OperatingMode, ProbingState, ProgramState, RequestStatus
from gateway.config.file import parse
from gateway.config.sections import Probing
from gateway.control.explaining import Explanations
from gateway.control.grid import GridSampler, Schedule
from gateway.control.loop import GridLoop
from gateway.control.measuring import Measuring
from gateway.control.trainer import Trainings
from gateway.model.compensation import Source
from gateway.model.events import CompensationStepped, ForecastMade, ReasonsGiven
from gateway.model.standing import Standing
from gateway.nc.probing.schedule import ProbingSchedule, schedule_of
from gateway.service.service import Service
from gateway.storage.store import Store
from talc.control import Controller
from talc.frame import Decision, EventKind, Frame, Measurement, Phase, Why
from talc.settings import ControlSettings, LearnerSettings, TalcSettings
from tests.benches.kept_events import KeptEvents
from tests.benches.nc_link_bench import LinkBench, ScriptedControl
from tests.benches.restarted import restarted
from tests.benches.service_file import FILE, TEXT
from tests.benches.stepped_clock import EPOCH, SteppedClock
from tests.benches.stored_steps import record_step
from tests.benches.thermal_series import series

STEP_S = 300.0
NOWHERE = ((0.0, 0.0, 0.0),) * 6
CYCLES_OF_THE_REFERENCE = [41, 42, 43, 44, 45]


@asynccontextmanager
async def running(
    bench: LinkBench,
    told: KeptEvents,
    *,
    pending: Why | None = None,
    retries: int = 2,
    settings: TalcSettings = TalcSettings(method="models"),  # noqa: B008 -- frozen
    probing: Probing = Probing(),  # noqa: B008 -- frozen
) -> AsyncIterator[ProbingSchedule]:
    plan = schedule_of(Probing(retries=retries))
    controller, clock = Controller(("a",), settings), bench.clock
    measuring, trainings = (
        Measuring(bench.link, plan, probing, clock, told, pending),
        Trainings(controller, clock, told),
    )
    followers = [Explanations(controller, STEP_S, clock, told).follow]
    grid = GridSampler(("a",), STEP_S), Schedule(STEP_S)
    loop = GridLoop(controller, *grid, clock, told, measuring, trainings, link=bench.link, followers=followers)
    task = asyncio.create_task(loop.run())
    try:
        async with bench.running():
            yield plan
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


async def test_a_calibration_measurement_is_requested_a_lead_time_before_its_step_ends() -> None:
    bench, told = LinkBench("monitor"), KeptEvents()
    bench.control.answer = RequestStatus(0, ProbingState.DONE, NOWHERE)
    async with running(bench, told):
        await bench.clock.run_until(STEP_S + 119.0)
        assert (
            bench.control.requests == []
        )  # the measurement was wanted from the first step on; 180 s before the second is 420 s
        await bench.clock.run_until(2 * STEP_S + 1.0)
        assert bench.control.requests == CYCLES_OF_THE_REFERENCE
        assert told.frames[-1].measurement is not None
    assert [o.standing for o in told.outlooks] == [Standing.DUE, Standing.ASKED, Standing.NOT_WANTED]


async def test_what_blocks_probing_is_published_and_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    bench, told = LinkBench("monitor"), KeptEvents()
    bench.control.mode = OperatingMode.JOG
    async with running(bench, told):
        await bench.clock.run_until(4 * STEP_S)
        assert bench.control.requests == []
        bench.control.mode = OperatingMode.AUTO
        bench.control.answer = RequestStatus(0, ProbingState.DONE, NOWHERE)
        await bench.clock.run_until(5 * STEP_S)
    assert told.texts(EventKind.PROBLEM) == ["probing: the control is in JOG, not in AUTO"]
    assert len(told.texts(EventKind.PROBLEM_ENDED)) == 1
    logged = [r.message for r in caplog.records if "in JOG" in r.message and r.levelname == "WARNING"]
    assert logged == told.texts(EventKind.PROBLEM) + told.texts(EventKind.PROBLEM_ENDED)
    standings = [o.standing for o in told.outlooks]
    assert standings == [Standing.BLOCKED, Standing.DUE, Standing.ASKED, Standing.NOT_WANTED]
    assert bench.control.requests == CYCLES_OF_THE_REFERENCE


@pytest.mark.parametrize("absent", [False, True])
async def test_a_run_that_begins_with_a_wanted_measurement_first_tries_to_reach_the_control(absent: bool) -> None:
    bench, told = LinkBench("monitor"), KeptEvents()
    bench.control.absent = absent
    at_once = Probing(lead_s=STEP_S)
    async with running(bench, told, pending=Why.CALIBRATION, probing=at_once):
        await bench.clock.run_until(100.0)
    assert told.texts(EventKind.PROBLEM) == (["probing: the control cannot be reached"] if absent else [])
    assert bool(bench.control.requests) is not absent


async def test_a_measurement_that_is_no_longer_wanted_is_never_requested() -> None:
    bench, told = LinkBench("monitor"), KeptEvents()
    bench.control.program, bench.control.speed = ProgramState.RUNNING, 8000.0
    async with running(bench, told, pending=Why.INTERVAL) as plan:
        await bench.clock.run_until(200.0)
        plan.want(None, bench.clock.monotonic())
        bench.control.program, bench.control.speed = ProgramState.ABORTED, 0.0
        await bench.clock.run_until(250.0)
    assert bench.control.requests == []
    assert [o.standing for o in told.outlooks] == [Standing.WAITING, Standing.NOT_WANTED]


@pytest.mark.parametrize("sigma_um", [4.0, 6.0])
async def test_what_is_far_too_uncertain_is_measured_whatever_the_program_does(sigma_um: float) -> None:
    bench, told = LinkBench("monitor"), KeptEvents()
    bench.control.program, bench.control.speed = ProgramState.RUNNING, 8000.0
    bench.control.answer = RequestStatus(0, ProbingState.DONE, NOWHERE)
    plan = schedule_of(Probing(retries=2))
    measuring = Measuring(bench.link, plan, Probing(lead_s=STEP_S), bench.clock, told)
    nothing = np.zeros(9)
    decision = Decision(
        0, Phase.COMPENSATION, nothing, nothing, nothing + sigma_um, nothing + 5.0, Why.UNCERTAINTY, None, ()
    )
    async with bench.running(), asyncio.TaskGroup() as tasks:
        measuring.want(decision)
        measuring.begin(tasks, STEP_S)
        await bench.clock.run_until(200.0)
        assert bool(bench.control.requests) is (1.96 * sigma_um > 2 * 5.0)
        plan.want(None, bench.clock.monotonic())
        await bench.clock.run_until(250.0)


@pytest.mark.slow
async def test_a_cycle_that_keeps_failing_is_requested_only_a_few_times_and_the_operator_is_informed_once() -> None:
    bench, told = LinkBench("monitor"), KeptEvents()
    bench.control.answer = RequestStatus(0, ProbingState.FAILED, reason="a touch found no sphere")
    async with running(bench, told, retries=2):
        await bench.clock.run_until(3000.0)
    assert len(bench.control.requests) == 3
    assert [o.why for o in told.outcomes] == [Why.CALIBRATION, Why.RETRY, Why.RETRY]
    assert all(o.reason == "the cycle failed: a touch found no sphere" for o in told.outcomes)
    assert all(f.measurement is None for f in told.frames)
    assert len(told.texts(EventKind.OPERATOR)) == 1
    assert "Clean the sphere" in told.texts(EventKind.OPERATOR)[0]


@pytest.mark.slow
async def test_the_learner_says_why_after_each_measurement_and_each_hour() -> None:
    bench, told = LinkBench("monitor"), KeptEvents()
    bench.control.answer = RequestStatus(0, ProbingState.DONE, NOWHERE)
    fixed = LearnerSettings(policy="fixed", measurement_interval_steps=13)
    async with running(bench, told, settings=TalcSettings(learner=fixed)):
        await bench.clock.run_until(17 * STEP_S)
    first = told.frames[0].k
    measured = [f.k - first for f in told.frames if f.measurement is not None]
    given = [event.reasons for event in told.of(ReasonsGiven)]
    assert measured == [1, 14]
    assert [r.k - first for r in given] == [0, 1, 13, 14]
    assert [r.next_k - first for r in given] == [1, 14, 14, 27]


@pytest.mark.slow
async def test_the_learner_says_after_each_step_what_the_next_hours_bring() -> None:
    bench, told = LinkBench("monitor"), KeptEvents()
    bench.control.answer = RequestStatus(0, ProbingState.DONE, NOWHERE)
    async with running(bench, told, settings=TalcSettings()):
        await bench.clock.run_until(15 * STEP_S)
    said = told.of(ForecastMade)
    assert [each.forecast.k for each in said] == [f.k for f in told.frames]
    assert said[0].forecast.ahead_s == (1800.0, 3600.0, 7200.0, 10800.0, 14400.0, 21600.0, 28800.0)
    known = [bool(np.isfinite(each.misses.value[0]).all()) for each in said]
    # The first value is of the second step; six forecasts over half an hour have then come due after twelve more.
    assert known == [False] * 12 + [True] * (len(known) - 12)


async def test_a_restart_remembers_since_when_an_input_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    day = series(288, seed=41)
    channels = ", ".join(f"{name} = {i % 6}" for i, name in enumerate(day.names[:6]))
    more = "\n".join(f"{name} = {i % 6}" for i, name in enumerate(day.names[6:]))
    text = (
        TEXT.replace("bed_front = 0", channels)
        + f"""
[[device]]
name = "rtd2"
bus = "rtu1"
profile = "icpdas_m7015"
unit = 2
[device.channels]
{more}
[nc]
kind = "sinumerik"
url = "opc.tcp://127.0.0.1:4840"
security = "none"
[compensation]
inputs_stale_after_s = 3060.0
"""
    )
    config = parse(text, FILE)
    storage = config.storage.model_copy(update={"path": tmp_path / "gateway.sqlite"})
    talc = replace(config.talc, method="models", control=ControlSettings(calibration_steps=288))
    config = config.model_copy(update={"storage": storage, "talc": talc})
    clock, controller = SteppedClock(), Controller(day.names, config.talc)
    first_k = int(clock.utc().timestamp() // STEP_S) - 300
    with Store(config.storage.path, "boot", clock) as store:
        store.begin(config.canonical(), config.fingerprint(), "")
        lost, models = "", None
        for k in range(294):
            valid = np.array([name != lost for name in day.names])
            row = min(k, 287)
            measured = Measurement(day.measured[row], np.full(9, 0.5)) if k < 288 else None
            frame = Frame(first_k + k, day.inputs[row], valid, measured)
            made, trained = record_step(store, controller, frame)
            models = trained or models
            if k == 289:
                assert models is not None
                lost = next(m.inputs[0] for m in models.models if m is not None and m.inputs)
    past = restarted(config)
    assert past.missing == {lost: first_k + 290}
    told = KeptEvents()
    monkeypatch.setattr("gateway.service.service.control_of", lambda *_: ScriptedControl(clock))
    link = Service(config, clock, told, past).link
    assert link is not None
    link.follow(replace(made, k=first_k + 300))
    task = asyncio.create_task(link.run())
    await clock.run_until(100.0)
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
    writes = [event.write for event in told.of(CompensationStepped)]
    stale = [(w.time - EPOCH).total_seconds() for w in writes if w.step.source is Source.INPUTS_STALE]
    assert writes[0].step.source is Source.PREDICTION
    assert stale[0] == pytest.approx(60.0, abs=2.0), "missing for ten steps before the start"
