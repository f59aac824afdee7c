"""The whole gateway, killed at any moment while it compensates, judged by the control's own record.

`python -m tests.benches.gateway_kills 200`: as many kills, in two and a half minutes.

The processes and wires are real, only faster than on a machine: ten cycles a second, 20 µm/s. A gateway dies at a
message on one of its wires that is drawn beforehand, so the speed of the computer decides nothing. Some messages with
the heartbeat come so late that the control's watchdog begins to ramp while the gateway lives.
"""

import asyncio
import math
import os
import signal
import sqlite3
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import AsyncExitStack, asynccontextmanager, closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.base import SystemClock
from gateway.config.file import load
from gateway.config.model import GatewayConfig
from gateway.runtime.clocks import RealClock
from gateway.storage.store import Store
from simulators.devices import Adam6015, TcpHost
from simulators.nc import Activity, CycleSettings, DayPart, EmulatedControl, LoadCase, MeanLoads
from simulators.nc.watchdog import R_BEAT, Logged
from talc.control import Controller
from talc.frame import Frame, Measurement
from tests.benches import waits
from tests.benches.cut_wire import CutWire, wire_to
from tests.benches.processes import is_alive
from tests.benches.still_machine import StillMachine
from tests.benches.stored_steps import record_step

PERIOD_S, RATE_UM_PER_S, SILENCE_S, STEP_S = 0.1, 20.0, 0.6, 0.5
BOUND_UM = (6.0, 6.0, 8.0)
CALIBRATION = 200
READY_S = 300.0
MOST_MESSAGES = 80
"""The most messages between the moment from which a gateway may die and its death: some eight cycles."""
BEAT, LATE_S, LATE = f"R[u1,{R_BEAT}]".encode(), 0.7, 0.03
"""In messages that read or write the heartbeat; such a share of them come this much later. Never a write of offsets."""
TEXT = """
[machine]
name = "mill"
[grid]
step_s = {step}
[storage]
path = "gateway.sqlite"
[telemetry]
enabled = false
[[bus]]
name = "tcp1"
kind = "modbus_tcp"
host = "127.0.0.1"
port = {modbus}
period_s = 0.2
[[device]]
name = "adam"
bus = "tcp1"
profile = "advantech_adam6015"
unit = 1
[device.channels]
column = 0
table = 1
[nc]
kind = "sinumerik"
url = "{nc}"
security = "none"
period_s = {period}
[probing]
lead_s = 0.0
[compensation]
mode = "compensate"
bound_um = [6.0, 6.0, 8.0]
slew_um_per_s = {rate}
stale_after_s = 3.0
watchdog_s = {silence}
[talc]
method = "models"

[talc.control]
calibration_steps = {calibration}
"""


def temperatures(k: float) -> tuple[float, float]:
    """Temperatures that change quickly enough for every gateway to have something to follow."""
    return 22.0 + 8.0 * math.sin(k / 4.0), 22.0 + 6.0 * math.sin(k / 5.5 + 1.0)


def calibrated(config: GatewayConfig) -> None:
    """A store as a calibration that ended just now leaves it: EZ0A follows the column, EX0C the table."""
    draw, controller, models = np.random.default_rng(2), Controller(config.input_names, config.talc), None
    first = math.floor(time.time() / STEP_S) - CALIBRATION - 1
    with Store(config.storage.path, "calibration", SystemClock()) as store:
        store.begin(config.canonical(), config.fingerprint(), "")
        for k in range(first, first + CALIBRATION):
            column, table = temperatures(k)
            errors = draw.normal(0.0, 0.05, 9)
            errors[1] += 1.5 * (column - 22.0)
            errors[2] += 1.5 * (table - 22.0)
            frame = Frame(k, np.array([column, table]), np.ones(2, np.bool_), Measurement(errors, np.full(9, 0.1)))
            _, trained = record_step(store, controller, frame)
            models = trained or models
    assert models is not None
    assert models.models[1] is not None
    assert models.models[2] is not None


def change_um(log: Sequence[Logged], i: int) -> float:
    """Largest change of an axis by the gateway's entry `i`, from what was in force when the gateway sent it: just
    before, or, while the watchdog ramped, at most half of the silence ago."""
    was, k = [log[i - 1].values_mm if i else (0.0, 0.0, 0.0)], i - 1
    while k >= 0 and log[k].ramped and log[i].time_s - log[k].time_s <= SILENCE_S / 2:
        k -= 1
        was.append(log[k].values_mm if k >= 0 else (0.0, 0.0, 0.0))
    return float(np.abs(np.array(was) - log[i].values_mm).max(axis=1).min()) * 1e3


def judged(log: Sequence[Logged]) -> None:
    """No change at once by more than one period's worth, but for what the watchdog ramped while a write was under way;
    none beyond the bound; and between any two moments no more than that and what the rate allows, when one write was
    under way for as long as it may be, half of the silence."""
    times = np.array([entry.time_s for entry in log])
    values = np.array([entry.values_mm for entry in log]) * 1e3
    most = RATE_UM_PER_S * PERIOD_S
    assert (np.abs(values) <= np.array(BOUND_UM) + 1e-6).all()
    for i, entry in enumerate(log):
        if not entry.ramped:
            assert change_um(log, i) <= most + 1e-6, entry
    for i in range(len(log)):
        reach = RATE_UM_PER_S * (times[i:] - times[i] + SILENCE_S / 2) + most + 1e-6
        assert (np.abs(values[i:] - values[i]) <= reach[:, None]).all(), log[i]


def written(log: Sequence[Logged]) -> bool:
    """Whether a gateway changed offsets, not the control's watchdog alone."""
    return any(not entry.ramped for entry in log)


def stepped_twice(log: Sequence[Logged]) -> bool:
    """Whether a gateway moved Z by more than one period's worth."""
    values_mm = [entry.values_mm[2] for entry in log if not entry.ramped]
    return bool(values_mm) and float(np.ptp(values_mm)) > 1e-3 * RATE_UM_PER_S * PERIOD_S


async def until(condition: Callable[[], bool], pid: int) -> None:
    """Wait for what a gateway does; it must not end by itself before."""
    await waits.until(lambda: condition() or not is_alive(pid), READY_S, pause_s=0.005)
    assert condition(), "the gateway ended by itself"


class Wires:
    """Kills a gateway at a message between it and its devices, before that is handed on; hands some beats on late."""

    def __init__(self, draw: np.random.Generator, *wires: CutWire) -> None:
        self._draw = draw
        self._pid, self._left, self._killed = 0, 0, False
        for wire in wires:
            wire.delay, wire.spoil = self._ask, self._answer

    async def kill(self, pid: int, messages: int) -> None:
        """Kill at the message after this many."""
        self._pid, self._left, self._killed = pid, messages, False
        await until(lambda: self._killed, pid)

    def _ask(self, data: bytes) -> float:
        self._answer(data)
        return LATE_S if BEAT in data and self._draw.random() < LATE else 0.0

    def _answer(self, data: bytes) -> bytes:
        if self._pid and not self._left:
            os.kill(self._pid, signal.SIGKILL)
            self._pid = 0
            self._killed = True
        self._left -= 1
        return data


async def killed(kills: int, control: EmulatedControl, wires: Wires, start: Callable[[], Awaitable[int]]) -> int:
    """Kill this many gateways one after another; returns how many had moved the offsets when they died."""
    draw, nck, moved = np.random.default_rng(kills), control.nck, 0
    for number in range(kills):
        beat, entries = nck.r[R_BEAT], len(nck.log)
        pid = await start()
        if number % 3 == 1:  # once it lives; every third while it starts
            await until(lambda beat=beat: nck.r[R_BEAT] != beat, pid)  # type: ignore[misc]
        if number % 3 == 2:  # once it has moved the offsets, every other time by more than one step
            enough = stepped_twice if number % 6 == 5 else written
            await until(lambda entries=entries, enough=enough: enough(nck.log[entries:]), pid)  # type: ignore[misc]
        await wires.kill(pid, int(draw.integers(MOST_MESSAGES)))
        control.now()
        moved += written(nck.log[entries:])
        if number % 6 == 5:  # the next one comes while the watchdog ramps, or after
            rest_mm = float(draw.uniform()) * largest_mm(control)
            await waits.until(lambda rest_mm=rest_mm: largest_mm(control) <= rest_mm)  # type: ignore[misc]
    return moved


def largest_mm(control: EmulatedControl) -> float:
    """The largest offset in force now."""
    control.now()
    return max(map(abs, control.nck.k0_mm))


@dataclass(frozen=True, slots=True)
class Kills:
    """What a run of gateways left."""

    log: Sequence[Logged]
    """Every change of the control's offsets."""
    count: int
    moved: int
    """How many of them had moved the offsets when they died."""
    whole: bool
    """Whether the database is."""

    @property
    def reached_um(self) -> float:
        """From the lowest to the highest offset of Z."""
        return float(np.ptp([entry.values_mm[2] for entry in self.log])) * 1e3


@asynccontextmanager
async def gateways(config: Path, log: Path) -> AsyncIterator[Callable[[], Awaitable[int]]]:
    """Starts a gateway after the previous one was killed, and gives its process id."""
    with log.open("wb") as errors:
        zygote = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "tests.benches.gateways_to_kill", str(config)),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=errors,
            cwd=Path(__file__).parents[2],
        )
    assert zygote.stdin is not None
    assert zygote.stdout is not None
    stdin, stdout = zygote.stdin, zygote.stdout

    async def start() -> int:
        stdin.write(b"start\n")
        return int(await asyncio.wait_for(stdout.readline(), READY_S))

    try:
        yield start
    finally:
        stdin.close()
        await zygote.wait()


async def gateways_killed(kills: int, folder: Path) -> Kills:
    """As many gateways, one after another; returns when the watchdog has taken back what the last one left."""
    rest = LoadCase([DayPart(0.0, 1e12, Activity.PAUSE, MeanLoads())])
    control = EmulatedControl(StillMachine(), RealClock(), rest, cycle=CycleSettings(noise_um=0.0))
    host = TcpHost({1: Adam6015(lambda: [*temperatures(time.time() / STEP_S), 20.0, 20.0, 20.0, 20.0, 20.0])})
    path = folder / "gateway.toml"
    async with AsyncExitStack() as stack:
        stack.push_async_callback(control.stop)
        stack.push_async_callback(host.stop)
        nc, url = await stack.enter_async_context(wire_to(await control.start()))
        modbus, address = await stack.enter_async_context(wire_to(f"tcp://127.0.0.1:{await host.start()}"))
        path.write_text(
            TEXT.format(
                step=STEP_S, modbus=address.rsplit(":", 1)[1], nc=url, period=PERIOD_S, rate=RATE_UM_PER_S,
                silence=SILENCE_S, calibration=CALIBRATION,
            )
        )  # fmt: skip
        config = load(path)
        await asyncio.to_thread(calibrated, config)
        start = await stack.enter_async_context(gateways(path, folder / "log"))
        moved = await killed(kills, control, Wires(np.random.default_rng(kills + 1), nc, modbus), start)
        await waits.until(lambda: largest_mm(control) == 0.0)
    with closing(sqlite3.connect(config.storage.path)) as connection:
        whole = connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    return Kills(control.nck.log, kills, moved, whole)


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        found = asyncio.run(gateways_killed(int(sys.argv[1]) if len(sys.argv) > 1 else 200, Path(folder)))
    judged(found.log)
    print(
        f"{found.count} kills, {found.moved} of them while offsets moved, {len(found.log)} changes, no step; "
        f"database {'whole' if found.whole else 'DAMAGED'}"
    )
    sys.exit(0 if found.whole else 1)


if __name__ == "__main__":
    main()
