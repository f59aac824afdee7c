"""Random faults and restarts, and what takes no simulated time.

`python -m tests.benches.soak` runs for longer.
"""

import asyncio
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from gateway.control.sensor_watch import SensorWatch
from gateway.model.events import EventReported, GatewayEvent, SensorsJudged
from talc.frame import Frame
from talc.settings import SensorCheckSettings
from tests.benches.plant_days import NAMES, plant_days
from tests.benches.simulated_time import held_time, simulated_time
from tests.benches.small_run import START
from tests.benches.soak import RightClock, fast_forward


@pytest.mark.slow
def test_faults_and_restarts() -> None:
    """In a separate process, so that what other tests keep open is not counted."""
    told = ["--days", "0.03", "--seed", "3", "--pause", "600", "--run", "1200"]
    command = [sys.executable, "-m", "tests.benches.soak", *told, "--begin", str(int(START))]
    ran = subprocess.run(command, cwd=Path(__file__).parents[2], capture_output=True, text=True)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    print(ran.stdout)


def test_held_time_does_not_pass_while_another_process_works() -> None:
    async def waited_s() -> float:
        begin_s, passed = time.monotonic(), asyncio.Event()
        later = asyncio.get_running_loop().call_later(7200.0, passed.set)
        with held_time():
            process = await asyncio.create_subprocess_exec(sys.executable, "-c", "sum(range(10_000_000))")
            assert await process.wait() == 0
        waited = time.monotonic() - begin_s
        assert not passed.is_set()
        later.cancel()
        return waited

    with simulated_time():
        assert asyncio.run(waited_s()) < 1.0


@pytest.mark.slow
def test_a_soak_waits_for_the_process_that_learns_the_sensors() -> None:
    """Else a simulated hour passes in a second, and the gateway says that the process did not end within it."""
    events: list[GatewayEvent] = []
    x = plant_days(1)
    names = tuple(NAMES)

    async def learnt() -> float:
        watch = SensorWatch(names, SensorCheckSettings(), 300.0, lambda _: True, events.append, RightClock())
        for k, row in enumerate(x):
            watch.follow(Frame(k, row, np.ones(len(names), dtype=np.bool_)))
        begin_s = time.monotonic()
        later = asyncio.get_running_loop().call_later(4000.0, lambda: None)
        await watch.look()
        await watch.look()
        later.cancel()
        return time.monotonic() - begin_s

    with fast_forward():
        took_s = asyncio.run(learnt())
    assert took_s < 1.0
    assert [type(event) for event in events] == [SensorsJudged], [
        event.event.text for event in events if isinstance(event, EventReported)
    ]
