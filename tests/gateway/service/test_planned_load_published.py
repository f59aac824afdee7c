"""A running service foresees a planned load, with what it has learnt from the frames of an earlier run."""

from pathlib import Path

import numpy as np

from gateway.config.file import parse
from gateway.control.sensor_watch import SeenBefore
from gateway.model.events import ForecastMade
from talc.frame import Frames
from tests.benches.free_port import free_port
from tests.benches.hot_bearing import BODIES, DAY, NAMES, bodies, work
from tests.benches.kept_events import KeptEvents
from tests.benches.reloaded_service import service_of
from tests.benches.service_file import UNPUBLISHED, adam6015
from tests.benches.stepped_clock import EPOCH, SteppedClock
from tests.benches.tasks import served

STEP_S = 300
PLANNED = """
[[state]]
name = "spindle_speed"
[[planned_load]]
name = "roughing"
loads = {spindle_speed = 7000.0}
[[planned_load]]
name = "too fast"
loads = {spindle_speed = 20000.0}
"""


async def test_a_service_foresees_the_planned_loads_of_its_configuration(tmp_path: Path) -> None:
    (tmp_path / "talc.key").write_text("k" * 64, encoding="utf-8")
    control = f'[nc]\nkind = "linuxcnc"\nhost = "127.0.0.1"\nport = {free_port()}\nkey_file = "talc.key"\n'
    channels = adam6015(", ".join(f"{name} = {i}" for i, name in enumerate(BODIES)))
    config = parse(UNPUBLISHED + channels + PLANNED + control, tmp_path / "gateway.toml")
    assert config.input_names == NAMES
    x, last_k = bodies(work(4, 6), 4), int(EPOCH.timestamp()) // STEP_S - 1
    frames = Frames(np.arange(last_k + 1 - 6 * DAY, last_k + 1), x, np.ones(x.shape, np.bool_), np.empty((0, 9)))
    clock, kept = SteppedClock(), KeptEvents()
    async with served(service_of(config, kept, clock, seen=SeenBefore(frames, None))):
        await clock.run_until(3.0 * STEP_S + 1.0)
    first, *_, latest = kept.of(ForecastMade)
    assert first.planned == {"roughing": None, "too fast": None}, "not learnt yet"
    assert latest.planned["too fast"] is None
    roughing = latest.planned["roughing"]
    assert roughing is not None
    assert roughing.value.shape == latest.forecast.value.shape
