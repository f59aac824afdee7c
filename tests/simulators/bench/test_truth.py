"""What the emulated machine records for the report."""

import asyncio
import csv
from pathlib import Path

import numpy as np

from simulators.bench.machine import TRUTH_COLUMNS, TRUTH_STEP_S, BenchMachine, TruthRecorder
from tests.benches.manual_clock import ManualClock


async def test_a_recorder_that_was_late_when_it_ends_has_written_every_minute(tmp_path: Path) -> None:
    clock = ManualClock()
    began_s = clock.utc().timestamp()
    machine = BenchMachine(1, clock, 2.0)
    recorder = asyncio.create_task(TruthRecorder(machine, clock, tmp_path / "truth.csv").run(lambda: False))
    await asyncio.sleep(0)
    clock.now = 1800.0  # without waking it
    recorder.cancel()
    await asyncio.gather(recorder, return_exceptions=True)
    with (tmp_path / "truth.csv").open(encoding="ascii") as file:
        header, *rows = csv.reader(file)
    assert header == list(TRUTH_COLUMNS)
    times = [float(row[0]) - began_s for row in rows]
    assert times == [TRUTH_STEP_S * i for i in range(1, 31)]


def test_minutes_before_a_write_are_noted_with_the_offsets_that_were_in_force() -> None:
    """The clock of a demo may be minutes ahead of what its machine has computed."""
    clock = ManualClock()
    machine = BenchMachine(1, clock, 2.0, None)
    machine.control.nck.write_k0(2, 0.020, clock.monotonic())
    clock.now = 600.0
    machine.control.nck.write_k0(2, 0.0, clock.monotonic())
    clock.now = 900.0
    machine.advance(clock.monotonic())
    rows = np.array(machine.truth())
    without, left = (rows[:, TRUTH_COLUMNS.index(name)] for name in ("dz", "rz"))
    assert np.round(without - left, 6).tolist() == [-20.0] * 10 + [0.0] * 5
