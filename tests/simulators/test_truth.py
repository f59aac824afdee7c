"""What the emulated machine writes down for the report."""

import asyncio
import csv
from datetime import UTC, datetime, timedelta
from pathlib import Path

from simulators.bench.machine import TRUTH_COLUMNS, TRUTH_STEP_S, BenchMachine, TruthRecorder

EPOCH = datetime(2026, 1, 5, 6, 0, tzinfo=UTC)


class LateClock:
    """Each sleep lasts until it is ended, whatever time it is then."""

    def __init__(self) -> None:
        self.now, self.ended = 0.0, asyncio.Event()

    def monotonic(self) -> float:
        return self.now

    def utc(self) -> datetime:
        return EPOCH + timedelta(seconds=self.now)

    async def sleep_until(self, monotonic_s: float) -> None:
        await self.ended.wait()


async def test_a_recorder_that_was_late_when_it_ends_has_written_every_minute(tmp_path: Path) -> None:
    clock = LateClock()
    machine = BenchMachine(1, clock, 2.0)
    recorder = asyncio.create_task(TruthRecorder(machine, clock, tmp_path / "truth.csv").run(lambda: False))
    await asyncio.sleep(0)
    clock.now = 1800.0
    recorder.cancel()
    await asyncio.gather(recorder, return_exceptions=True)
    with (tmp_path / "truth.csv").open(encoding="ascii") as file:
        header, *rows = csv.reader(file)
    assert header == list(TRUTH_COLUMNS)
    times = [float(row[0]) - EPOCH.timestamp() for row in rows]
    assert times == [TRUTH_STEP_S * i for i in range(1, 31)]
