"""Cost of the whole service in real time: `talc-gateway run` in one process, the emulated devices in others.

Processor time covers all threads of the service's process, from /proc; periods are those of the stored readings, by
their source times. Each is measured over three successive windows, and the median is shown.
"""

import json
import math
import os
import sqlite3
import subprocess
import sys
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, closing, contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import zenoh

from benchmarks.emulators import CHANNELS, UNITS
from benchmarks.rows import BenchRow
from drivers.base import Quality, SystemClock
from gateway.config.file import load
from gateway.config.model import GatewayConfig
from gateway.model.events import DecisionMade, FrameMade
from gateway.storage.store import Store
from gateway.telemetry import keys
from gateway.telemetry.codec import decode
from gateway.telemetry.messages import ReadingMessage
from simulators.bench import gateway_toml
from simulators.clock import SharedClock
from talc.control import Controller
from talc.frame import Frame, Measurement

_WINDOWS, _WINDOW_S = 3, 17.0
"""Number of windows and the length of each; figures are medians over them."""
_SETTLE_S = 5.0
_READY_S = 30.0
_LISTENER = "tcp/127.0.0.1:17447"
"""Where this process subscribes to the service: without a subscriber Zenoh has little to do."""
_SERVICE_PORT = 17448
"""Where the service itself listens; nobody connects."""


@dataclass(frozen=True, slots=True)
class Cost:
    """What a service used. Medians of the windows, except where stated otherwise."""

    share: float
    """Share of one core."""
    resident_mb: float
    """Resident memory at the end."""
    jitter_p99_ms: float
    """p99 over all channels of |interval - period|."""
    worst_p99_ms: float
    """The same in the worst window."""
    training: bool
    """Whether a training ran at the start of the first window and at the end of the last."""
    waited: float
    """Share of the time in which its event loop was ready but other programs had the cores."""
    first_s: float = math.nan
    """From the start of the process until a Zenoh subscriber had a good value of every channel."""
    heard: int = 0
    """Total number of messages that it received."""


def _ticks(pid: int) -> float:
    """Processor seconds, user and system, of all threads."""
    words = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rsplit(")", 1)[1].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def _waited_s(pid: int) -> float:
    """Seconds in which the main thread was ready and another one ran."""
    return int(Path(f"/proc/{pid}/schedstat").read_text(encoding="ascii").split()[1]) / 1e9


def _resident_mb(pid: int) -> float:
    lines = Path(f"/proc/{pid}/status").read_text(encoding="ascii").splitlines()
    return next(int(line.split()[1]) / 1024.0 for line in lines if line.startswith("VmRSS"))


def _children(pid: int) -> set[str]:
    return {c for task in Path(f"/proc/{pid}/task").iterdir() for c in (task / "children").read_text().split()}


class _MessageCounter:
    """A subscriber that counts messages, and records when it first had a good value of every channel."""

    def __init__(self, channels: Collection[str]) -> None:
        self._missing = set(channels)
        self.heard = 0
        self.complete_at: float | None = None
        """Monotonic seconds."""

    def __call__(self, sample: zenoh.Sample) -> None:
        self.heard += 1
        key = str(sample.key_expr)
        if self._missing and f"/{keys.READING}/" in key:
            reading = decode(keys.READING, sample.payload.to_bytes())
            if isinstance(reading, ReadingMessage) and reading.quality == Quality.GOOD:
                self._missing.discard(reading.channel)
                if not self._missing:
                    self.complete_at = time.monotonic()


def measured(path: Path, *, training: bool = False) -> Cost:
    """Run the service of a configuration and measure it once it has settled."""
    config = load(path)
    ear = _MessageCounter([channel.name for channel in config.channels])
    with zenoh.open(_listening()) as session:
        subscriber = session.declare_subscriber("talc/**", ear)
        launched = time.monotonic()
        cost = _measured(path, config, training)
        subscriber.undeclare()
    if ear.complete_at is None:
        raise RuntimeError("not every channel had a good value")
    return replace(cost, heard=ear.heard, first_s=ear.complete_at - launched)


def _listening() -> zenoh.Config:
    config = zenoh.Config()
    config.insert_json5("listen/endpoints", f'["{_LISTENER}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    return config


def _wait_for_child(pid: int) -> None:
    until = time.monotonic() + _READY_S
    while not _children(pid):
        if time.monotonic() > until:
            raise RuntimeError("the service did not start a training")
        time.sleep(0.1)


@dataclass(frozen=True, slots=True)
class Windows:
    """What a program used in successive windows of time."""

    shares: Sequence[float]
    """Share of one core."""
    waits: Sequence[float]
    """Share of the time in which its main thread was ready but other programs had the cores."""
    ends: Sequence[tuple[float, float]]
    """Begin and end of each, s since 1970."""
    resident_mb: float
    """Resident memory at the end."""


def _windows(pid: int, window_s: float) -> Windows:
    """Watch a running program."""
    shares, waits, marks = list[float](), list[float](), [time.time()]
    for _ in range(_WINDOWS):
        used, waited, begun = _ticks(pid), _waited_s(pid), time.monotonic()
        time.sleep(window_s)
        took = time.monotonic() - begun
        shares.append((_ticks(pid) - used) / took)
        waits.append((_waited_s(pid) - waited) / took)
        marks.append(time.time())
    return Windows(shares, waits, list(pairwise(marks)), _resident_mb(pid))


def run_in_windows(
    command: Sequence[str], folder: Path, settle_s: float, window_s: float, environment: Mapping[str, str] | None = None
) -> Windows:
    """Run a program in a folder, watch it once it has settled, and end it."""
    program = subprocess.Popen(command, cwd=folder, env=environment)
    try:
        time.sleep(settle_s)
        if program.poll() is not None:
            raise RuntimeError(f"{command} ended with {program.returncode}")
        return _windows(program.pid, window_s)
    finally:
        program.terminate()
        try:
            program.wait(_READY_S)
        except subprocess.TimeoutExpired:
            program.kill()
            program.wait()


def _measured(path: Path, config: GatewayConfig, training: bool) -> Cost:
    service = subprocess.Popen([sys.executable, "-m", "gateway", "run", str(path)])
    try:
        time.sleep(_SETTLE_S)
        if training:
            _wait_for_child(service.pid)
        trainer = _children(service.pid)
        used = _windows(service.pid, _WINDOW_S)
        trained = bool(trainer & _children(service.pid))
    finally:
        service.terminate()
        service.wait(30.0)
    if service.returncode != 0:
        raise RuntimeError(f"the service of {path} ended with {service.returncode}")
    late = [_late_p99_ms(config, since, until) for since, until in used.ends]
    return Cost(median(used.shares), used.resident_mb, median(late), max(late), trained, median(used.waits))


def _late_p99_ms(config: GatewayConfig, since: float, until: float) -> float:
    """p99 of |interval - period| over the good readings of a window, given by its wall-clock ends."""
    times = readings_of(config, since, until)
    late = [np.abs(np.diff(times[channel.name]) - channel.period_s) for channel in config.channels]
    return float(np.percentile(np.concatenate(late), 99)) * 1e3


def readings_of(config: GatewayConfig, since: float, until: float) -> dict[str, list[float]]:
    """When each channel had a good reading between these times, according to the service's store; s since 1970."""
    times: dict[str, list[float]] = {channel.name: [] for channel in config.channels}
    with closing(sqlite3.connect(config.storage.path)) as database:
        for channel, at in database.execute(
            "SELECT channel, time FROM sample WHERE quality = 'good' AND time > ? AND time < ? ORDER BY time",
            (since, until),
        ):
            times[channel].append(at)
    return times


def emulated() -> AbstractContextManager[dict[str, Any]]:
    """The devices of the 500 channels, and where they are."""
    return _process("benchmarks.emulators")


@contextmanager
def _process(*module: str) -> Iterator[dict[str, Any]]:
    """Emulators in a separate process, and the addresses that it prints when ready."""
    process = subprocess.Popen(
        [sys.executable, "-m", *module], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    if process.stdin is None or process.stdout is None:
        raise RuntimeError("the emulators' process has no pipes")
    try:
        yield json.loads(process.stdout.readline())
    finally:
        process.stdin.close()
        process.stdout.close()
        process.wait(_READY_S)


@contextmanager
def emulated_machine(folder: Path) -> Iterator[dict[str, Any]]:
    """The bench's emulated machine at real time."""
    epoch = datetime.now(UTC)
    clock = SharedClock(folder / "clock", epoch=epoch, owner=True)
    try:
        with _process("simulators.bench", str(folder), epoch.isoformat(), "1", "1", "1") as addresses:
            clock.start()
            yield addresses
    finally:
        clock.close()


def bench_config(folder: Path, addresses: dict[str, Any], *, nc: bool) -> Path:
    """The bench's own configuration at a real machine's rates: 1 s, the spindle's sensor 0.1 s."""
    places = {"folder": folder, "zenoh_port": _SERVICE_PORT, "zenoh_connect": f'["{_LISTENER}"]', "talc": ""}
    text = gateway_toml(addresses | places)
    before, growth, after = text.partition('name = "growth1"')
    text = before.replace("period_s = 100.0", "period_s = 1.0") + growth + after.replace("100.0", "0.1", 1)
    text = text.replace("period_s = 30.0", "period_s = 1.0").replace("poll_s = 10.0", "poll_s = 2.0")
    return _written(folder, text if nc else text[: text.index("# Machine states")])


def buses_config(folder: Path, addresses: dict[str, Any], talc: str = "") -> Path:
    """500 channels on 20 buses at 1 s."""
    places = [("modbus_rtu", f'port = "{port}"\nbaud = 115200', "icpdas_m7015") for port in addresses["lines"]]
    places += [("modbus_tcp", f'host = "127.0.0.1"\nport = {p}', "advantech_adam6015") for p in addresses["hosts"]]
    text = f'[machine]\nname = "many"\n[storage]\npath = "{folder}/gateway.sqlite"\n'
    text += f'[telemetry]\nconnect = ["{_LISTENER}"]\n'
    for n, (kind, place, _) in enumerate(places):
        text += f'[[bus]]\nname = "bus{n}"\nkind = "{kind}"\n{place}\n'
    for n, (_, _, profile) in enumerate(places):
        for unit in range(1, UNITS + 1):
            text += f'[[device]]\nname = "d{n}_{unit}"\nbus = "bus{n}"\nprofile = "{profile}"\nunit = {unit}\n'
            text += "[device.channels]\n" + "".join(f"t{n}_{unit}_{c} = {c}\n" for c in range(CHANNELS))
    return _written(folder, text + talc)


def _written(folder: Path, text: str) -> Path:
    path = folder / "gateway.toml"
    path.write_text(text, encoding="utf-8")
    return path


LONG_TRAINING = """
[talc]
method = "models"
[talc.training]
selector = "pso"
max_na = 5
max_nb = 5
max_inputs = 12
"""


def want_training(config: GatewayConfig) -> None:
    """Fill the store with an earlier run's calibration and its pending training, which a start then resumes."""
    steps = config.talc.control.calibration_steps
    draw, n, step_s = np.random.default_rng(0), len(config.input_names), config.grid.step_s
    inputs = 22.0 + np.cumsum(draw.normal(0, 0.1, (steps, n)), axis=0)
    errors = inputs[:, :9] - 22.0 + draw.normal(0, 0.5, (steps, 9))
    controller, first = Controller(config.input_names, config.talc), int(time.time() // step_s) - steps
    with Store(config.storage.path, "earlier", SystemClock()) as store:
        store.begin(config.canonical(), config.fingerprint(), "")
        for k in range(steps):
            frame = Frame(first + k, inputs[k], np.ones(n, np.bool_), Measurement(errors[k], np.full(9, 0.5)))
            store.record(FrameMade(frame))
            store.record(DecisionMade(controller.step(frame)))


def _row(work: str, cost: Cost) -> BenchRow:
    ours = f"{cost.share:.1%} of a core, {cost.resident_mb:.0f} MB resident"
    return BenchRow(work, ours, f"{cost.heard} messages came to a subscriber")


def _jitter(cost: Cost) -> str:
    return f"p99 of abs(interval - 1 s) {cost.jitter_p99_ms:.1f} ms, in the worst window {cost.worst_p99_ms:.1f} ms"


def _starved(cost: Cost) -> str:
    return f"its event loop waited {cost.waited:.1%} of the time for a core that other programs had"


def _bench_rows() -> list[BenchRow]:
    table = []
    for nc in (False, True):
        with TemporaryDirectory() as name, emulated_machine(Path(name)) as addresses:
            cost = measured(bench_config(Path(name), addresses, nc=nc))
        if nc:
            table.append(_row("the same, and an NC read and written at 1 Hz", cost))
        else:
            table.append(_row("service: 30 channels at 1 Hz, growth at 10 Hz", cost))
            first = "from its start until a subscriber had a good value of every channel"
            table.append(BenchRow(first, f"{cost.first_s:.1f} s"))
    return table


def _buses_rows() -> list[BenchRow]:
    with emulated() as addresses, TemporaryDirectory() as name:
        quiet = measured(buses_config(Path(name), addresses))
        path = buses_config(Path(name), addresses, LONG_TRAINING)
        Path(name, "gateway.sqlite").unlink()
        want_training(load(path))
        busy = measured(path, training=True)
        if quiet.training or not busy.training:
            raise RuntimeError(f"a training ran: {quiet.training}, {busy.training}; expected False, True")
        command = [sys.executable, "-m", "benchmarks.pymodbus_poll", str(_WINDOW_S), str(_WINDOWS)]
        command.append(json.dumps(addresses))
        out = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout
    share, bare_ms = json.loads(out)
    bare = f"p99 {median(bare_ms):.1f} ms in a bare loop of pymodbus clients, minutes later"
    periods = f"periods of the 500 channels, median of {_WINDOWS} windows of {_WINDOW_S:.0f} s"
    return [
        _row("service: 500 channels on 20 Modbus buses at 1 Hz", quiet),
        BenchRow(
            "a bare loop of pymodbus clients on them: nothing checked, stored or published",
            f"{share / quiet.share:.2f} × ours",
            f"{share:.1%} of a core",
        ),
        BenchRow(periods, _jitter(quiet), f"{_starved(quiet)}; {bare}"),
        BenchRow("the same while a training runs", _jitter(busy), _starved(busy)),
    ]


def rows() -> list[BenchRow]:
    """A machine of the usual size, then 500 channels, without and with a training beside it."""
    return [*_bench_rows(), *_buses_rows()]
