"""The memory of a gateway with many inputs that measures nothing: what grows with their square stays untouched."""

import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest

from drivers.base import SetupError
from gateway.config.file import parse
from gateway.control.restart.earlier import earlier_run
from gateway.storage.snapshot import Snapshot, decode_snapshot
from gateway.storage.store import Store
from talc.control import Controller
from talc.frame import Frame, Frames
from talc.learner import learner_bytes
from tests.benches.service_file import MACHINE, adam6015, m7015, rtu_bus
from tests.benches.snapshot_bytes import stored_bytes
from tests.benches.stepped_clock import SteppedClock

INPUTS = 500


def in_process(function: str) -> str:
    """What a function of this module prints in a separate process."""
    call = f"from {__name__} import {function}; {function}()"
    done = subprocess.run([sys.executable, "-c", call], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def memory_kb(field: str) -> int:
    """VmSize, the process's address space, or VmHWM, the most memory that it has had."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(field))


def day_and_restart() -> None:
    """Print how many MB the learner takes beside what was there before."""
    settings = parse(MACHINE + adam6015("bed = 0"), Path("gateway.toml")).talc
    before_kb, known, steps = memory_kb("VmHWM"), np.full(INPUTS, fill_value=True), 3
    controller = Controller(tuple(f"t{i}" for i in range(INPUTS)), settings, 300.0)
    rows = 20.0 + np.arange(steps)[:, None] + np.zeros(INPUTS)
    for k, row in enumerate(rows):
        controller.step(Frame(k, row, known))
        controller.reasons()
        controller.forecast((6, 12))
        controller.between(row, known, 0.5)
    data = stored_bytes(Snapshot("marks", controller.state(), None, {}, (None,) * 9))
    frames = Frames(np.arange(steps), rows, np.tile(known, (steps, 1)), np.full((steps, 9), np.nan))
    found = decode_snapshot(data, lambda _first, _last: frames)
    again = Controller.restore(found.state, settings, 300.0, None)
    again.step(Frame(steps, rows[-1], known))
    print((memory_kb("VmHWM") - before_kb) // 1024)


def start_in_a_little_memory() -> None:
    """Print what a gateway says if it may have 200 MB of address space beyond what it has at its start."""
    units = {unit: ", ".join(f"c{unit}_{i} = {i}" for i in range(6)) for unit in range(1, 51)}
    text = MACHINE + rtu_bus() + "".join(m7015(f"rtd{unit}", unit, channels) for unit, channels in units.items())
    with tempfile.TemporaryDirectory() as folder:
        config = parse(text, Path(folder) / "gateway.toml")
        with Store(Path(folder) / "gateway.sqlite", "boot-1", SteppedClock()) as store:
            most = memory_kb("VmSize") * 1024 + 200_000_000
            resource.setrlimit(resource.RLIMIT_AS, (most, resource.RLIM_INFINITY))
            with pytest.raises(SetupError) as caught:
                earlier_run(store, config)
    print(caught.value)


@pytest.mark.slow
def test_a_day_and_a_restart_leave_the_learners_memory_untouched() -> None:
    assert int(in_process("day_and_restart")) < learner_bytes(INPUTS) / 1e6 / 16


@pytest.mark.slow
def test_a_learner_that_does_not_fit_is_reported_in_words() -> None:
    said = in_process("start_in_a_little_memory")
    assert said.startswith("the computer has no 0.9 GB of address space for the learner of 300 inputs (use fewer")
