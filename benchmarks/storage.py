"""Amount that the store writes to the disk in a day, and the time of a restart on a record of years."""

import json
import sqlite3
import subprocess
import sys
import tempfile
import time
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from benchmarks.rows import BenchRow
from drivers.base import Clock, Quality, SystemClock
from gateway.config.file import parse
from gateway.config.model import GatewayConfig
from gateway.control.restart.earlier import EarlierRun, earlier_run
from gateway.control.restart.rebuild import controller_of
from gateway.control.restart.snapshots import SnapshotKeeper
from gateway.model.compensation import Source, Step, Write
from gateway.model.events import CompensationStepped, DecisionMade, FrameMade, MeasurementEnded, ReadingsTaken
from gateway.model.probing import Outcome
from gateway.model.sample import Sample
from gateway.storage.readings import Retention
from gateway.storage.store import Store
from talc.frame import FloatArray, Frame, Measurement, Why

_DEVICES, _EACH = 7, 4
_CHANNELS, _STEP_S, _STEPS_A_YEAR = _DEVICES * _EACH, 300, 365 * 288
_REAL_S = 400
"""Length of the part that runs at the real pace. At its end the log is put into the database, as when it has grown to
its limit."""
_BEGAN = datetime(2026, 1, 1, tzinfo=UTC)
_KEEP_EVERY_S = 600
"""As often as the store's thread does it."""
_AT_ONCE, _DECIDED, _RESTARTS = 20_000, 300, 7
_TEXT = """
[machine]
name = "mill"
[storage]
path = "gateway.sqlite"
[[bus]]
name = "tcp1"
kind = "modbus_tcp"
host = "nowhere"
"""
_DEVICE = '[[device]]\nname = "adam{0}"\nbus = "tcp1"\nprofile = "advantech_adam6015"\nunit = {1}\n[device.channels]\n'
_STILL = Step((1.0, 2.0, 3.0), (1.0, 2.0, 3.0), Source.PREDICTION, (False, False, False))
_FILL = (
    "INSERT INTO frame VALUES (?1, 'earlier', ?2, ?3, ?4, ?4)",
    "INSERT INTO decision SELECT ?1, 'compensation', zeroblob(72), zeroblob(72), zeroblob(72), zeroblob(72), NULL,"
    " NULL, '[]' WHERE ?2 <> ?3 OR ?4 IS NULL",
    "INSERT INTO trust SELECT ?1, x'0000' WHERE ?2 <> ?3 OR ?4 IS NULL",
    "INSERT INTO event SELECT NULL, '2026-01-01T00:00:00+00:00', ?1, 'state_update', 'a measurement was learnt from',"
    " NULL, NULL, NULL WHERE ?2 <> ?3 AND ?4 IS NOT NULL",
)
_RESTART = "import sys; from benchmarks.storage import restart; restart(sys.argv[1])"


def config_in(folder: Path) -> GatewayConfig:
    """A gateway of 28 temperatures on seven devices."""
    devices = (
        _DEVICE.format(d, d + 1) + "".join(f"t{_EACH * d + i} = {i}\n" for i in range(_EACH)) for d in range(_DEVICES)
    )
    return parse(_TEXT + "".join(devices), folder / "gateway.toml")


def rows() -> list[BenchRow]:
    """Wear, and restarts on a record of one year and of five."""
    with tempfile.TemporaryDirectory(dir=".") as folder:  # not in /tmp, which may be memory
        table = [
            BenchRow(
                "written to the disk in a day, 28 channels at 1 Hz",
                f"{(new := wear(Path(folder))) + (old := thinning(Path(folder))):.2f} GB",
                f"{new:.2f} GB in the first week; {old:.2f} GB more when as many readings become old as are new",
            )
        ]
    return [*table, restart_row(1.0), restart_row(5.0)]


def restart_row(years: float) -> BenchRow:
    """Several restarts on one record, one after the other; the median of each figure."""
    with tempfile.TemporaryDirectory(dir=".") as folder:
        config = config_in(Path(folder))
        fill(config, years)
        size = config.storage.path.stat().st_size / 1e6
        command = [sys.executable, "-c", _RESTART, folder]
        done = [
            json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
            for _ in range(_RESTARTS)
        ]
    found = {name: float(np.median([one[name] for one in done])) for name in done[0]}
    slowest_s = max(one["decided_s"] for one in done)
    return BenchRow(
        f"restart on a {years:g}-year record ({size:.0f} MB), median of {_RESTARTS}: controller there, first decision",
        f"{found['rebuilt_s']:.2f} s, {found['decided_s']:.2f} s",
        f"{found['processor_s']:.2f} s of processor time; {found['imported_s']:.2f} s to import; slowest"
        f" {slowest_s:.2f} s; {found['memory_mb']:.0f} MB of memory at most",
    )


class PlayedClock:
    """Seconds since a fixed date; `now_s` is set."""

    now_s = 0.0

    def monotonic(self) -> float:
        return self.now_s

    def utc(self) -> datetime:
        return _BEGAN + timedelta(seconds=self.now_s)


def wear(folder: Path, real_s: int = _REAL_S) -> float:
    """GB a day of all that is stored, at the real pace, in the first week: readings, steps of the grid each 300 s and
    of the compensation each 20 s, a measurement each 2 h and a snapshot a day.
    """
    config, clock, machine = config_in(folder), SystemClock(), StoredMachine()
    with Store(config.storage.path, "boot", clock, commit_s=config.storage.commit_s) as store:
        past = earlier_run(store, config)
        store.begin(config.canonical(), config.fingerprint(), "")
        store.flush()
        began_bytes, began_s = _written(config), time.monotonic()
        for second in range(real_s):
            machine.record(second, store, past, clock)
            time.sleep(max(0.0, began_s + second + 1 - time.monotonic()))
        store.flush()
        a_day = (_written(config) - began_bytes) * 86400.0 / real_s
        return (a_day + _seldom(store, past, config, clock, machine.x)) / 1e9


def thinning(folder: Path, turns: int = 30) -> float:
    """GB a day that the minute statistics of readings that become old add, from the second week on."""
    return played(folder / "thinned", turns, 1.0 / 24.0) - played(folder / "kept", turns, 1e3)


def played(folder: Path, turns: int, samples_days: float) -> float:
    """GB a day of what comes each second, played with a commit every `commit_s`.

    Readings are kept for an hour instead of a week: after the first third of the turns, as many become old as are new.
    Every ten minutes the store is opened again, which makes it do what it does every ten minutes; another connection
    keeps that from putting the log into the database. The figure does not include the kernel's own writes of the log's
    index while time passes.
    """
    folder.mkdir()
    config, clock, machine = config_in(folder), PlayedClock(), StoredMachine()
    path, every, retention = config.storage.path, round(config.storage.commit_s), Retention(samples_days=samples_days)
    with Store(path, "first", clock) as store:
        past = earlier_run(store, config)
        store.begin(config.canonical(), config.fingerprint(), "")
    began_bytes = 0
    with closing(sqlite3.connect(path)) as other:
        other.execute("SELECT count(*) FROM boot").fetchall()  # opens the file, and delays nothing
        for turn in range(turns):
            if turn == turns // 3:
                began_bytes = _written(config)
            with Store(path, f"run {turn}", clock, retention=retention) as store:
                for second in range(turn * _KEEP_EVERY_S, (turn + 1) * _KEEP_EVERY_S):
                    clock.now_s = float(second)
                    machine.record(second, store, past, clock)
                    if second % every == every - 1:
                        store.flush()
        return (_written(config) - began_bytes) * 86400.0 / ((turns - turns // 3) * _KEEP_EVERY_S) / 1e9


class StoredMachine:
    """What a gateway stores of a machine in each second."""

    def __init__(self) -> None:
        self._draw = np.random.default_rng(1)
        self.x = 20.0 + self._draw.normal(0, 2, _CHANNELS)

    def record(self, second: int, store: Store, past: EarlierRun, clock: Clock) -> None:
        self.x += self._draw.normal(0, 0.01, _CHANNELS)
        for device in range(_DEVICES):
            store.record(ReadingsTaken(_readings(device, self.x, clock, second)))
        if second % 20 == 0:
            write = Write(clock.utc(), "compensate", _STILL, second, {"X": 1.0}, True, (1.0, 2.0, 3.0))
            store.record(CompensationStepped(write))
        if second % _STEP_S == _STEP_S // 2:
            frame = Frame(second // _STEP_S, self.x.copy(), np.ones(_CHANNELS, np.bool_), None)
            store.record(FrameMade(frame))
            store.record(DecisionMade(past.controller.step(frame)))


def _seldom(store: Store, past: EarlierRun, config: GatewayConfig, clock: Clock, x: FloatArray) -> int:
    """Bytes a day of twelve measurements and a snapshot, each with the log put into the database."""
    measured = Measurement(np.linspace(-5.0, 5.0, 9), np.full(9, 0.5))
    now, before = clock.utc(), _written(config)
    outcome = Outcome(1, Why.INTERVAL, now, now, np.ones((6, 3)), (0.0, 0.0, 0.0), measured, 0.4)
    store.record(MeasurementEnded(outcome))
    store.flush()
    a_measurement, before = _written(config) - before, _written(config)
    keeper = SnapshotKeeper(past, store, config, every_steps=1)
    frame = Frame(_REAL_S, x, np.ones(_CHANNELS, np.bool_), measured)
    keeper.take(FrameMade(frame))
    keeper.take(DecisionMade(past.controller.step(frame)))
    store.flush()
    return 12 * a_measurement + _written(config) - before


def _readings(device: int, x: FloatArray, clock: Clock, sequence: int) -> list[Sample]:
    """Each device reads once a second; its reads are numbered together with those of the others."""
    number = sequence * _DEVICES + device
    return [
        Sample(f"t{i}", round(float(x[i]), 2), "degC", Quality.GOOD, clock.utc(), clock.monotonic(), sequence=number)
        for i in range(_EACH * device, _EACH * (device + 1))
    ]


def _written(config: GatewayConfig) -> int:
    """Bytes that this process has sent to disks so far, from the kernel, with all of the log in the database."""
    with closing(sqlite3.connect(config.storage.path)) as connection:
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    lines = Path("/proc/self/io").read_text(encoding="ascii").splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("write_bytes"))


def fill(config: GatewayConfig, years: float) -> None:
    """A record of years, with a measurement each two hours; only the last 300 are the controller's own."""
    last = round(SystemClock().utc().timestamp() / _STEP_S) - 2
    first, middle = last - round(years * _STEPS_A_YEAR), last - _DECIDED
    draw, mask = np.random.default_rng(3), np.packbits(np.ones(_CHANNELS, np.bool_)).tobytes()
    with Store(config.storage.path, "earlier", SystemClock()) as store:
        store.begin(config.canonical(), config.fingerprint(), "")
    with closing(sqlite3.connect(config.storage.path)) as connection:
        for begin in range(first, middle, _AT_ONCE):
            k = np.arange(begin, min(begin + _AT_ONCE, middle))
            x = 20.0 + np.sin(k[:, None] / 300.0 + np.arange(_CHANNELS)) + draw.normal(0, 0.02, (len(k), _CHANNELS))
            found = [
                (int(at), row.tobytes(), mask, (row[:9] - 20.0).tobytes() if at % 24 == 0 else None)
                for at, row in zip(k, x, strict=True)
            ]
            for statement in _FILL:
                connection.executemany(statement, found)
        connection.commit()
    with Store(config.storage.path, "before", SystemClock()) as store:
        store.begin(config.canonical(), config.fingerprint(), "")
        past = EarlierRun(controller_of(config))
        keeper = SnapshotKeeper(past, store, config)
        for k_now in range(middle, last):
            x = 20.0 + np.sin(k_now / 300.0 + np.arange(_CHANNELS))
            measured = Measurement(x[:9] - 20.0, np.full(9, 0.5)) if k_now % 24 == 0 else None
            frame = Frame(k_now, x, np.ones(_CHANNELS, np.bool_), measured)
            for event in (FrameMade(frame), DecisionMade(past.controller.step(frame))):
                store.record(event)
                keeper.take(event)


def restart(folder: str) -> None:
    """In a fresh process: from the start of the interpreter, as the kernel knows it, to the first decision."""
    ticks = float(Path("/proc/self/stat").read_text(encoding="ascii").rsplit(")", 1)[1].split()[19]) / 100.0
    imported_s = time.clock_gettime(time.CLOCK_BOOTTIME) - ticks
    config = config_in(Path(folder))
    with Store(config.storage.path, "now", SystemClock()) as store:
        past = earlier_run(store, config)
        store.begin(config.canonical(), config.fingerprint(), "")
        rebuilt_s = time.clock_gettime(time.CLOCK_BOOTTIME) - ticks
        last = past.last_k or 0
        past.controller.step(Frame(last + 1, np.full(_CHANNELS, 20.0), np.ones(_CHANNELS, np.bool_), None))
        decided_s = time.clock_gettime(time.CLOCK_BOOTTIME) - ticks
    peak = next(x for x in Path("/proc/self/status").read_text().splitlines() if x.startswith("VmHWM"))
    found = {"rebuilt_s": rebuilt_s, "decided_s": decided_s, "memory_mb": int(peak.split()[1]) / 1024}
    print(json.dumps({**found, "imported_s": imported_s, "processor_s": time.process_time()}))
