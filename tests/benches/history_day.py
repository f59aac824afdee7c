"""Cost of a day's history: `python -m tests.benches.history_day [HOURS]`, with all of the day or its first hours.

A store gets a day of 30 channels at 1 Hz, eight on a module, as a gateway of one day has it. The publisher of the
program answers queries from it over Zenoh on loopback, and the typed client makes tables. Both are in this process: its
processor time covers the gateway, the network and the reader together.
"""

import asyncio
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import closing
from datetime import UTC, date, datetime
from pathlib import Path

import numpy as np

from drivers.base import Quality, SystemClock
from gateway.config.telemetry import Telemetry
from gateway.service.stored_answers import history_of
from gateway.storage.readings import QUALITIES, Channels, Pruning, Retention
from gateway.storage.schema import connect, make_schema
from gateway.telemetry.client import Machine
from gateway.telemetry.publisher import TelemetryPublisher
from tests.benches.free_port import free_port

DAY = date(2026, 3, 2)
_CHANNELS = 30
_PRUNED_EVERY_S = 600


def _fill(path: Path, seconds: int) -> None:
    """Fill a store as it writes the readings itself, with the means that it makes each ten minutes."""
    begin_s = datetime.combine(DAY, datetime.min.time(), UTC).timestamp()
    values = 20.0 + np.cumsum(np.random.default_rng(1).normal(0.0, 0.01, (seconds, _CHANNELS)), axis=0)
    make_schema(path)

    def rows(first_s: int) -> Iterator[tuple[object, ...]]:
        for at_s in range(first_s, first_s + _PRUNED_EVERY_S):
            for channel, value in enumerate(values[at_s].round(3).tolist(), start=1):
                number = (1 << 32 | (at_s + 1)) << 11 | channel
                yield number, begin_s + at_s + 0.05 * (channel // 8), value, QUALITIES.index(Quality.GOOD), None

    with closing(connect(path)) as connection:
        names = Channels([(channel, f"t{channel:02d}", "degC") for channel in range(1, _CHANNELS + 1)]).rows()
        connection.executemany("INSERT INTO channel VALUES (?, ?, ?)", names)
        pruning = Pruning(Retention(), 0.0)
        for first_s in range(0, seconds, _PRUNED_EVERY_S):
            connection.executemany("INSERT INTO reading VALUES (?, ?, ?, ?, ?)", rows(first_s))
            if first_s + _PRUNED_EVERY_S < seconds:  # of the last ten minutes there are none yet
                pruning.prune(connection, float(first_s + _PRUNED_EVERY_S))
            connection.commit()


async def _ask(path: Path) -> None:
    settings = Telemetry(listen=(f"tcp/127.0.0.1:{free_port()}",))
    async with TelemetryPublisher(
        settings, "mill", (), SystemClock(), "boot", simulated=False, history=history_of(path)
    ):
        with Machine(connect=settings.listen[0], answer_limit_s=60.0) as machine:
            machine.day(date(2026, 1, 1), every_s=60.0)  # imports pandas
            for title, every_s in (
                ("minutes", 60.0),
                ("ten minutes", 600.0),
                ("10 s", 10.0),
                ("single readings", None),
            ):
                began_s, used_s = time.monotonic(), time.process_time()
                table = await asyncio.to_thread(machine.day, DAY, every_s=every_s)
                took_s, used_s = time.monotonic() - began_s, time.process_time() - used_s
                values = int(table.notna().to_numpy().sum())
                print(f"| {title} | {values} | {used_s:.2f} s | {took_s:.2f} s |", flush=True)


def main(hours: float) -> None:
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "gateway.sqlite"
        _fill(path, round(hours * 6) * _PRUNED_EVERY_S)
        print("| a day of 30 channels at 1 Hz as | values | processor | took |")
        asyncio.run(_ask(path))


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 24.0)
