"""A whole run with chips on the sphere: rejected results are stored, requested again, and never reach a model."""

import asyncio
import math
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest

from drivers.base import Quality, Reading
from drivers.nc import ProbingState, RequestStatus
from gateway.config.file import parse
from gateway.config.sections import Probing
from gateway.control.grid import GridSampler, Schedule
from gateway.control.loop import GridLoop
from gateway.control.measuring import Measuring
from gateway.control.replay.stored import replay
from gateway.control.trainer import Trainings
from gateway.nc.probing.schedule import schedule_of
from gateway.storage.history import History
from gateway.storage.store import Store
from talc.control import Controller
from talc.frame import TrainingJob, Why
from talc.models import ModelSet
from talc.papers.training import train
from tests.benches.nc_link_bench import LinkBench
from tests.benches.service_file import FILE, TEXT
from tests.benches.stepped_clock import EPOCH

STEP_S = 300.0
CALIBRATION, STEPS = 24, 60
CHIPS = {8, 20, 21, 50}
"""Measurements (not cycles) in which swarf lies under one touch."""
CONFIG = f"""{TEXT}
[talc]
method = "models"
[talc.control]
calibration_steps = {CALIBRATION}
policy = "fixed"
measurement_interval_steps = 2
"""


async def here(job: TrainingJob) -> ModelSet:
    return train(job)


@pytest.mark.slow
async def test_a_chip_never_reaches_a_frame_or_a_model_and_the_replay_is_identical(tmp_path: Path) -> None:
    config = parse(CONFIG, FILE)
    bench, draw = LinkBench("monitor"), np.random.default_rng(3)
    control = bench.control
    truth: list[float] = []

    def temperature(now_s: float) -> float:
        return 20.0 + 6.0 * math.sin(now_s / 4000.0) + 3.0 * (now_s / STEP_S > 15)

    async def answered(number: int) -> RequestStatus:
        """EZ0A follows the temperature with 2 µm/K; the sphere is found displaced by it in Z, with noise and chips."""
        measurement = number - 41 - 4  # the first five cycles are the reference
        z = 2.0 * (temperature(bench.clock.monotonic()) - 20.0) if measurement > 0 else 0.0
        centres = draw.normal(0.0, 0.3e-3, (6, 3))
        centres[:, 2] += z * 1e-3
        centres[2, 0] += 0.04 * (measurement in CHIPS)
        truth.append(z)
        return RequestStatus(number, ProbingState.DONE, tuple((x, y, w) for x, y, w in centres.tolist()))

    control.probing_status = answered  # type: ignore[method-assign]
    database = tmp_path / "gateway.sqlite"
    with Store(database, "boot", bench.clock) as store:
        store.begin(config.canonical(), config.fingerprint(), "")
        sampler = GridSampler(config.input_names, STEP_S)
        plan = schedule_of(Probing(retries=3))
        controller, clock, keep = Controller(config.input_names, config.talc), bench.clock, store.record
        loop = GridLoop(
            controller, sampler, Schedule(STEP_S), clock, keep, Measuring(bench.link, plan, Probing(), clock, keep),
            Trainings(controller, clock, keep, run=here), link=bench.link,
        )  # fmt: skip
        task = asyncio.create_task(loop.run())
        async with bench.running():
            for step in range(2 * STEPS):
                now = step * STEP_S / 2
                await bench.clock.run_until(now)
                at = EPOCH + timedelta(seconds=now)
                sampler.add([Reading("bed_front", temperature(now), "degC", Quality.GOOD, at, now)])
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
    with History(database) as history:
        cycles, steps = history.measurements(), list(history.steps())
        result = replay(history)
    rejected = [m for m in cycles if m.errors is None]
    assert len(rejected) == len(CHIPS)
    assert all("pose 3 stands out in X" in m.reason and m.centres_mm is not None for m in rejected)
    # Each was asked for again at the next step, and the frame of its own step contains no measurement.
    after = [cycles[i + 1].why for i, m in enumerate(cycles) if m.errors is None]
    assert after == [Why.RETRY] * len(CHIPS)
    measured = [s.frame.measurement for s in steps]
    assert len([m for m in measured if m is not None]) >= len(cycles) - len(rejected) - 1  # the last one waits
    errors = np.array([m.errors for m in measured if m is not None])
    assert np.abs(errors[:, [0, 2, 3, 4, 5]]).max() < 2.5  # a chip of 40 µm makes 10 µm of EX0C
    assert any(s.adopted for s in steps)
    assert result.identical, result.first
