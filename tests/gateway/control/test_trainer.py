"""Training in a separate process: the same models, and a clear message on failure.

The process: tests/gateway/runtime/workers/test_process.py.
"""

import asyncio
import logging
import os
from dataclasses import replace

import numpy as np
import pytest

from gateway.config.sections import Probing
from gateway.control.grid import GridSampler, Schedule
from gateway.control.loop import GridLoop
from gateway.control.measuring import Measuring
from gateway.control.trainer import Trainings, models_of_failure, train_apart
from gateway.nc.probing.schedule import schedule_of
from gateway.runtime.workers.process import WorkError
from talc.control import Controller
from talc.frame import EventKind, Frame, Measurement, Phase, TrainingJob, Why
from talc.models import ModelSet
from talc.papers.training import train
from talc.settings import ControlSettings, TalcSettings, TrainingSettings
from tests.benches.kept_events import KeptEvents
from tests.benches.processes import children
from tests.benches.stepped_clock import SteppedClock
from tests.benches.thermal_series import series
from tests.benches.waits import until

DAY = series(288, seed=41)
JOB = TrainingJob(
    0, Why.CALIBRATION, DAY.names, DAY.inputs, np.ones(DAY.inputs.shape, np.bool_), DAY.measured, TrainingSettings()
)


@pytest.mark.slow
async def test_gives_bit_for_bit_the_models_of_this_process() -> None:
    assert (await train_apart(JOB)).fingerprint() == train(JOB).fingerprint()
    assert children(os.getpid()) == []


async def test_what_the_training_raises_is_reported() -> None:
    broken = replace(JOB, measured=JOB.measured[:, :4])
    with pytest.raises(WorkError, match=r"IndexError: .* \(exit status 1\)"):
        await train_apart(broken)


@pytest.mark.slow
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
        await until(lambda: log.adopted)
        await clock.run_until(900.0)
    finally:
        running.cancel()
        with pytest.raises(asyncio.CancelledError):
            await running
    assert log.adopted[0].failed
    rejected = log.texts(EventKind.MODEL_REJECTED)
    assert len(rejected) == 1
    assert "IndexError" in rejected[0]
    assert "the models stay as they were" in rejected[0]
    assert log.decisions[-1].phase is Phase.COMPENSATION
    assert np.isfinite(log.decisions[-1].predicted).all()


def test_a_failed_training_is_distinguished_from_one_that_found_nothing() -> None:
    failed = models_of_failure(JOB, WorkError("x"))
    nothing = train(replace(JOB, measured=np.full_like(JOB.measured, np.nan)))
    assert (failed.failed, nothing.failed) == (True, False)
    for models in (failed, nothing):
        stored = models.to_dict()
        assert ModelSet.from_dict(stored).failed is models.failed
        stored.pop("failed", None)
        assert ModelSet.from_dict(stored).failed is models.failed, "as an earlier program has stored it"
