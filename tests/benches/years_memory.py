"""`python -m tests.benches.years_memory --years 5`: the memory of a gateway's parts, grid step after grid step.

Everything that keeps something from one step to the next, set up as `run` does it, for the demo's machine with its 36
inputs: store with its pruning, controller with the learner, daily snapshots, sensor check, planned loads, reasons and
forecasts, health, metrics, and telemetry with an open Zenoh session. Each step has a reading of each channel,
a frame, whatever the controller decides, a step of the compensation, and a measurement where the controller wanted one.
The sensor check learns in another process, as in a gateway; here one process does that every day.
Nothing sleeps: five years are 525,600 steps of 300 s, about 40 minutes of a processor; `--step-s 3600` takes 43,800.

Not in it: drivers and buses, the connection to the control (`tests.benches.service_memory` and `soak` have them, for 30
and 365 days). What the store prunes each 600 s it prunes each 2 s of the computer's time here; forecasts are made at
each twelfth step.

Prints a Markdown table, in the middle of a simulated day: memory of this process (RSS, with all pages of the
libraries that it has in use), the part of it that is no file, open descriptors, threads, and the database.
"""

import argparse
import asyncio
import logging
import multiprocessing
import tempfile
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.base import Quality, Reading
from gateway.acquisition.board import Board
from gateway.config.applied import ConfigurationApplied
from gateway.config.file import load
from gateway.config.model import GatewayConfig
from gateway.control.explaining import Explanations
from gateway.control.planned_loads import PlannedLoads
from gateway.control.restart.earlier import past_in
from gateway.control.restart.snapshots import SnapshotKeeper
from gateway.control.sensor_watch import SensorWatch
from gateway.model.compensation import Source, Step, Write
from gateway.model.events import (
    CompensationStepped,
    DecisionMade,
    EventReported,
    Events,
    FrameMade,
    OutlookChanged,
    ReadingsTaken,
)
from gateway.model.sample import samples
from gateway.service.health import HealthWatch
from gateway.service.memory import give_back_large_blocks
from gateway.service.metrics import GatewayFigures
from gateway.storage.store import Store
from gateway.telemetry.publisher import TelemetryPublisher
from simulators.bench import gateway_toml
from talc.frame import BoolArray, FloatArray, Frame, Measurement
from talc.sensor_model import learn
from tests.benches import idle_loop
from tests.benches.free_port import free_port
from tests.benches.service_memory import memory_mb
from tests.benches.stepped_clock import EPOCH
from tests.benches.wire_clock import WireClock

_PRUNE_S = 2.0
"""Between two deletions of what is old, by the computer's time."""
_YEAR = 365
_EXPLAIN_EVERY = 12
"""Steps. A gateway forecasts at each one, which takes half the time of all of this."""
_NOISE_K, _NOISE_UM = 0.05, 0.3
_FAULTY = 0.002
"""Share of the readings without a value."""
_PLANNED = '[[planned_load]]\nname = "warm-up"\nloads = {spindle_speed = 4000.0}\n'


def _config(folder: Path, step_s: int) -> GatewayConfig:
    """The demo's; its buses are never opened."""
    ports = {"rtu_port": "/nowhere/rtu", "tcp_port": 502, "can_port": "/nowhere/can", "growth_port": "/nowhere/growth"}
    fillings = {**ports, "nc_port": 4840, "zenoh_port": free_port(), "zenoh_connect": "[]", "folder": str(folder)}
    text = gateway_toml(fillings | {"talc": _PLANNED})
    text = text.replace("step_s = 300.0", f"step_s = {step_s}.0")
    text = text.replace("stale_after_s = 900.0", f"stale_after_s = {3 * step_s}.0")
    (folder / "gateway.toml").write_text(text, encoding="utf-8")
    return load(folder / "gateway.toml")


class SimulatedShifts:
    """Loads of shifts, temperatures that follow them and the seasons with lags of hours, errors that follow those."""

    def __init__(self, temperatures: int, loads: int, a_day: int) -> None:
        self._a_day = a_day
        self._draw = draw = np.random.default_rng(1)
        self._gain = draw.uniform(0.0, 6.0, (temperatures, loads))
        self._pole = draw.uniform(0.9, 0.995, temperatures) ** (288 / a_day)
        self._of_error = draw.normal(0.0, 1.0, (9, temperatures))
        self._above = np.zeros(temperatures)
        self._loads = np.zeros(loads)

    def step(self, k: int) -> tuple[FloatArray, FloatArray]:
        """Inputs (temperatures, loads as shares of the largest) and true errors (9,), µm."""
        a_day = self._a_day
        if k % (a_day // 24) == 0:
            works = k // a_day % 7 < 5 and a_day // 4 <= k % a_day < a_day * 11 // 12
            self._loads = self._draw.uniform(0.0, 1.0, self._loads.size) if works else np.zeros(self._loads.size)
        self._above = self._pole * self._above + (1.0 - self._pole) * (self._gain @ self._loads)
        season = 4.0 * np.sin(2.0 * np.pi * k / (_YEAR * a_day)) + 1.5 * np.sin(2.0 * np.pi * k / a_day)
        noise = self._draw.normal(0.0, _NOISE_K, self._above.size)
        return np.concatenate(
            [np.round(20.0 + season + self._above + noise, 2), self._loads]
        ), self._of_error @ self._above


def _readings(
    config: GatewayConfig, inputs: NDArray[np.float64], valid: BoolArray, at_s: float, utc: datetime
) -> list[Reading]:
    quality = {True: Quality.GOOD, False: Quality.SENSOR_FAULT}
    return [
        Reading(
            channel.name,
            value if good else float("nan"),
            "um" if channel.name == "spindle_growth" else "degC",
            quality[good],
            utc,
            at_s,
            "" if good else "broken wire",
        )
        for channel, value, good in zip(config.channels, inputs.tolist(), valid.tolist(), strict=False)
    ]


def _row(day: float, database: Path, began_s: float) -> None:
    found = memory_mb()
    descriptors = len(list(Path("/proc/self/fd").iterdir()))
    size_mb = sum(file.stat().st_size for file in database.parent.glob(f"{database.name}*")) / 1e6
    print(
        f"| {day / _YEAR:.2f} | {found['RSS']:.0f} | {found['of it not pages of files']:.0f} | {descriptors} "
        f"| {threading.active_count()} | {size_mb:.0f} | {(time.monotonic() - began_s) / 60.0:.0f} |",
        flush=True,
    )


def _looks(days: int) -> Iterator[float]:
    yield from (0.5, 1.5, 10.5, 40.5)
    yield from (quarter * _YEAR / 4 // 1 + 0.5 for quarter in range(1, 4 * days // _YEAR))


async def lived(config: GatewayConfig, days: int, process: Executor, clock: WireClock) -> None:
    """Take the steps of these days, and print the table. process: for what a gateway leaves to another process"""
    names, database = config.input_names, config.storage.path
    channels = {channel.name for channel in config.channels}
    step_s = round(config.grid.step_s)
    a_day = 86_400 // step_s
    with Store(database, "boot", clock, commit_s=config.storage.commit_s, prune_s=_PRUNE_S) as store:
        past = past_in(store, config)
        store.begin(config.canonical(), config.fingerprint(), "")
        publisher = TelemetryPublisher(config.telemetry, config.machine.name, names, clock, "boot", simulated=True)
        figures, board = GatewayFigures(config.machine.name, "0"), Board({c.name: c.period_s for c in config.channels})
        async with publisher as telemetry:
            keeper = SnapshotKeeper(past, store, config)
            events = Events(store.record, telemetry.publish, figures.take, keeper.take)
            health = HealthWatch(
                config.grid.step_s, board, None, clock, lambda: store.health, lambda: True, events.publish
            )
            events.subscribe(DecisionMade, health.decided)
            events.subscribe(OutlookChanged, health.outlook_changed)
            sink = events.publish
            units = {"spindle_growth": "um"}
            planned = PlannedLoads(
                names,
                config.grid.step_s,
                {p.name: p.loads for p in config.planned_loads},
                lambda name: name not in channels,
                clock,
            )
            sensors = SensorWatch(
                names,
                config.sensor_check,
                config.grid.step_s,
                lambda name: name in channels and name not in units,
                sink,
                clock,
                learn=lambda *given: asyncio.get_running_loop().run_in_executor(process, learn, *given),
                is_load=lambda name: name not in channels,
            )
            explanations = Explanations(past.controller, config.grid.step_s, clock, sink, planned.changes)
            sink(ConfigurationApplied(config))
            machine = SimulatedShifts(len(config.channels), len(names) - len(config.channels), a_day)
            watching = [asyncio.create_task(sensors.run()), asyncio.create_task(planned.run())]
            draw, first_k = np.random.default_rng(2), int(EPOCH.timestamp()) // step_s
            process.submit(int).result()  # its pipes and threads are there before the first row
            looks, began_s, wanted = list(_looks(days)), time.monotonic(), False
            print("| simulated years | RSS, MB | of it no file, MB | descriptors | threads | database, MB | minutes |")
            print("|---|---|---|---|---|---|---|")
            for n in range(days * a_day):
                await clock.run_until(n * float(step_s))
                k, now = first_k + n, EPOCH + timedelta(seconds=n * step_s)
                inputs, truth = machine.step(k)
                valid = draw.random(inputs.size) >= _FAULTY
                read = samples(_readings(config, inputs, valid, clock.monotonic(), now), n)
                board.put(read)
                sink(ReadingsTaken(read))
                measured = (
                    Measurement(truth + draw.normal(0.0, _NOISE_UM, 9), np.full(9, _NOISE_UM)) if wanted else None
                )
                frame = Frame(k, inputs, valid, measured)
                decision = past.controller.step(frame)
                sink(FrameMade(frame))
                sink(DecisionMade(decision))
                for event in decision.events:
                    sink(EventReported(event, k))
                wanted = decision.measure is not None
                z_um = float(np.clip(np.nan_to_num(decision.corrected[1]), -50.0, 50.0))
                step = Step((0.0, 0.0, z_um), (0.0, 0.0, z_um), Source.PREDICTION, (False, False, False))
                sink(CompensationStepped(Write(now, "compensate", step, k, {"Z": -z_um / 1e3}, False, None)))
                sensors.frame(frame)
                planned.frame(frame)
                if n % _EXPLAIN_EVERY == 0:
                    explanations.follow(frame, decision)
                health.report()
                await clock.rest()
                if n % a_day == 0:
                    store.flush()
                if looks and n >= looks[0] * a_day:
                    _row(looks.pop(0), database, began_s)
            _row(days, database, began_s)
            for task in watching:
                task.cancel()


def main() -> None:
    options = argparse.ArgumentParser(description="The memory of a gateway's parts over years.")
    options.add_argument("--years", type=float, default=5.0, help="simulated")
    options.add_argument("--step-s", type=int, default=300, help="of the grid, a divisor of an hour")
    given = options.parse_args()
    logging.disable(logging.CRITICAL)
    give_back_large_blocks()  # as `run` does
    print(f"{datetime.now(UTC):%Y-%m-%d}, {given.years:g} years in steps of {given.step_s} s")
    with (
        tempfile.TemporaryDirectory() as folder,
        ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as process,
    ):
        clock = WireClock()
        idle_loop.run(lived(_config(Path(folder), given.step_s), round(given.years * _YEAR), process, clock))


if __name__ == "__main__":
    main()
