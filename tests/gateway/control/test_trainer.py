"""Training in a separate process: the same models, a clear message on failure, and no process left behind."""

import asyncio
import logging
import os
import resource
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gateway.apart import WorkError, apart
from gateway.config import Probing
from gateway.control import GridLoop, GridSampler, Measuring, Schedule, Trainings, has_failed
from gateway.control.trainer import models_of_failure, train_apart
from gateway.probing import schedule_of
from talc.control import Controller
from talc.frame import EventKind, Frame, Measurement, Phase, TrainingJob, Why
from talc.settings import ControlSettings, TalcSettings, TrainingSettings
from talc.training import train
from tests.benches.kept_events import KeptEvents
from tests.benches.processes import children, read_if_there
from tests.benches.stepped_clock import SteppedClock
from tests.benches.thermal_series import series

DAY = series(288, seed=41)
JOB = TrainingJob(
    0, Why.CALIBRATION, DAY.names, DAY.inputs, np.ones(DAY.inputs.shape, np.bool_), DAY.measured, TrainingSettings()
)
MINUTES = replace(JOB, settings=TrainingSettings(selector="pso", max_na=5, max_nb=5, max_inputs=12))
"""Takes at least some seconds: long enough to be observed while it computes."""


async def until(condition: Callable[[], bool], within_s: float = 120.0) -> None:
    async with asyncio.timeout(within_s):
        while not condition():
            await asyncio.sleep(0.01)


def is_computing(pid: int) -> bool:
    """Whether it has used a tenth of a second more than an interpreter takes to start."""
    stat = read_if_there(Path(f"/proc/{pid}/stat")).rpartition(b")")[2].split()
    return len(stat) > 12 and (int(stat[11]) + int(stat[12])) / os.sysconf("SC_CLK_TCK") > 0.1


async def test_gives_bit_for_bit_the_models_of_this_process() -> None:
    assert (await train_apart(JOB)).fingerprint() == train(JOB).fingerprint()
    assert children(os.getpid()) == []


async def test_it_computes_at_a_lower_priority_than_the_gateway() -> None:
    own = os.getpriority(os.PRIO_PROCESS, 0)
    assert await apart(os.getpriority, os.PRIO_PROCESS, 0) == min(own + 10, 19)


async def test_what_the_training_raises_is_reported() -> None:
    broken = replace(JOB, measured=JOB.measured[:, :4])
    with pytest.raises(WorkError, match=r"IndexError: .* \(exit status 1\)"):
        await train_apart(broken)


async def test_a_killed_training_is_reported() -> None:
    training = asyncio.create_task(train_apart(MINUTES))
    await until(lambda: len(children(os.getpid())) == 1)
    os.kill(children(os.getpid())[0], signal.SIGKILL)
    with pytest.raises(WorkError, match="SIGKILL; out of memory"):
        await training


async def test_work_beyond_its_limit_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gateway.apart.process.WORK_LIMIT_S", 0.05)
    with pytest.raises(WorkError, match="did not finish"):
        await train_apart(MINUTES)
    assert children(os.getpid()) == []


async def test_a_computer_without_descriptors_is_reported() -> None:
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    spare = os.open(os.devnull, os.O_RDONLY)
    os.close(spare)
    resource.setrlimit(resource.RLIMIT_NOFILE, (spare, limits[1]))
    try:
        with pytest.raises(WorkError, match=r"no process could be started: .*Too many open files"):
            await train_apart(JOB)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, limits)
    assert children(os.getpid()) == []


async def test_cancelling_ends_the_process() -> None:
    training = asyncio.create_task(train_apart(MINUTES))
    await until(lambda: len(children(os.getpid())) == 1 and is_computing(children(os.getpid())[0]))
    training.cancel()
    with pytest.raises(asyncio.CancelledError):
        await training
    assert children(os.getpid()) == []


async def test_ends_when_the_gateway_is_killed() -> None:
    code = (
        "import asyncio; from gateway.control.trainer import *; from tests.gateway.control.test_trainer import MINUTES"
    )
    gateway = await asyncio.create_subprocess_exec(sys.executable, "-c", f"{code}; asyncio.run(train_apart(MINUTES))")
    try:
        await until(lambda: bool(children(gateway.pid)) and is_computing(children(gateway.pid)[0]))
        training = children(gateway.pid)[0]
        gateway.kill()
        await until(lambda: not _is_there(training))
    finally:
        if gateway.returncode is None:
            gateway.kill()
        await gateway.wait()


def _is_there(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rsplit(")", 1)[1].split()[0]
    except OSError:
        return False
    return state != "Z"


async def test_the_old_models_go_on_after_a_crash(caplog: pytest.LogCaptureFixture) -> None:
    """A second training that crashes is an event and a log entry; the first one's models predict as before."""
    caplog.set_level(logging.CRITICAL, logger="gateway.control.trainer")
    control = ControlSettings(calibration_steps=288)
    controller = Controller(DAY.names, TalcSettings(method="models", control=control))
    first: TrainingJob | None = None
    for k in range(288):
        measurement = Measurement(DAY.measured[k], np.full(9, 0.5))
        first = controller.step(Frame(k, DAY.inputs[k], np.ones(12, np.bool_), measurement)).training or first
    assert first is not None
    controller.adopt(train(first))
    crashing, log, clock = replace(first, measured=first.measured[:, :4]), KeptEvents(), SteppedClock()
    sampler, schedule = GridSampler(DAY.names, 300.0), Schedule(300.0)
    plan = schedule_of(Probing(prefer_idle_s=0.0, insist_after_s=0.0, retries=0, pause_s=0.0))
    measuring, trainings = Measuring(None, plan, Probing(), clock, log), Trainings(controller, clock, log, crashing)
    loop = GridLoop(controller, sampler, schedule, clock, log, measuring, trainings)
    running = asyncio.create_task(loop.run())
    try:
        await until_adopted(clock, log)
        await clock.run_until(900.0)
    finally:
        running.cancel()
        with pytest.raises(asyncio.CancelledError):
            await running
    assert has_failed(log.adopted[0])
    rejected = log.texts(EventKind.MODEL_REJECTED)
    assert len(rejected) == 1
    assert "IndexError" in rejected[0]
    assert "the models stay as they were" in rejected[0]
    assert log.decisions[-1].phase is Phase.COMPENSATION
    assert np.isfinite(log.decisions[-1].predicted).all()


async def until_adopted(clock: SteppedClock, log: KeptEvents) -> None:
    deadline = time.monotonic() + 60.0
    while not log.adopted:
        assert time.monotonic() < deadline
        await clock.run_until(0.0)
        await asyncio.sleep(0.01)


def test_a_failed_training_is_distinguished_from_one_that_found_nothing() -> None:
    assert has_failed(models_of_failure(JOB, WorkError("x")))
    assert not has_failed(train(replace(JOB, measured=np.full_like(JOB.measured, np.nan))))
