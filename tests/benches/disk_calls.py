"""A short life of a gateway, and again with a fault at its n-th call that changes the disk, for each n.

The life: start on a new file, measure, learn, compensate, take snapshots, stop; start again, delete what is old, go on,
stop; start on a file that is said to be damaged, which is mended, go on, stop. The gateway is the whole service with
its store, the control is the emulated one in this process, and time is simulated; only the store's thread runs in real
time. A layer under the process (`failing_disk.cc`) counts the calls and refuses them.

A fault lasts until the gateway has gone on with it for two steps, or has refused to start, or has stopped; or it is a
single one. Whatever it does, a gateway that refuses to start is started again, as systemd would.

`python -m tests.benches.disk_calls` prints a table; `--step 20` takes each twentieth call only.
"""

import asyncio
import ctypes
import faulthandler
import json
import os
import re
import sqlite3
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from contextlib import ExitStack, closing, suppress
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from unittest.mock import patch

import click

from gateway.config import GatewayConfig, validate
from gateway.events import DecisionMade, GatewayEvent, in_order
from gateway.nc import Identity
from gateway.past import SnapshotKeeper, past_in
from gateway.replay import replay
from gateway.service import Service
from gateway.storage import History, Retention, Store, StoreError, damage_found
from simulators.nc import Activity, CycleSettings, DayPart, LoadCase, MeanLoads
from simulators.nc.nck import Nck
from tests.benches.disk_faults import FAULTS, HANGS_ONCE, DiskFault, LifeVerdict
from tests.benches.emulated_bench import DayPlant
from tests.benches.in_process_nc import InProcess
from tests.benches.preloads import preload
from tests.benches.spoilt_stores import reading
from tests.benches.wire_bench import assert_never_stepped
from tests.benches.wire_clock import WireClock

ROOT = Path(__file__).parents[2]
_SOURCE = Path(__file__).with_name("failing_disk.cc")
_STEP_S, _PERIOD_S, _OFFSET_UM = 300.0, 10.0, 6.0
_STEPS_A_RUN, _HEALED_AFTER_STEPS, _RUNS = 5, 2, 3
_LIMIT_S = 900
"""Real seconds of one life; it takes less than one."""
_STARTS = 3
"""Of one run: the fault ends with the first that is refused."""
_WORDS = {
    "w": "write", "t": "truncate", "s": "synchronise", "c": "create a file", "r": "rename", "l": "link", "u": "unlink"
}  # fmt: skip


def config_in(folder: Path, *, continues: bool) -> GatewayConfig:
    """A gateway without devices; its inputs are states of the control.

    continues: whether it compensates while nothing can be stored
    """
    return validate(
        {
            "machine": {"name": "mill"},
            "telemetry": {"enabled": False},
            "storage": {
                "path": str(folder / "g.sqlite"),
                "compensate_unstored": continues,
                "unstored_after_s": 1e-6,
                "warn_free_mb": 0.0,
            },
            "nc": {
                "kind": "sinumerik",
                "url": "opc.tcp://127.0.0.1:4840",
                "security": "none",
                "period_s": _PERIOD_S,
            },
            "grid": {"step_s": _STEP_S},
            "probing": {"armed": True, "lead_s": 200.0, "poll_s": 10.0, "reference_cycles": 1, "prefer_idle_s": 0.0},
            "compensation": {"mode": "compensate", "watchdog_s": 60.0},
            "talc": {"learner": {"shortest_interval_steps": 1, "longest_interval_steps": 2}},
        }
    )


class Life:
    """One gateway and its control.

    Parameters
    ----------
    folder: of the database, on the disk that fails
    fault, at: at which call it begins; None: the disk works
    """

    def __init__(self, folder: Path, fault: DiskFault | None, at: int) -> None:
        self.verdict = LifeVerdict()
        self._fault, self._healed = fault, False
        self._config = config_in(folder, continues=at % 2 == 1)
        self._path = self._config.storage.path
        self._clock, self._plant = WireClock(), DayPlant()
        rest = LoadCase([DayPart(0.0, 1e12, Activity.PAUSE, MeanLoads())])
        self._nck = Nck(self._plant, rest, cycle=CycleSettings(noise_um=0.0))
        self._disk = ctypes.CDLL(None)
        self._disk.disk_call_names.restype = ctypes.c_char_p
        self._made: list[int] = []
        """Grid indices of the steps that were decided."""
        self._lost: set[int] = set()
        """Of those, the ones of a run that said that it could not store everything."""
        if fault is None:
            self._disk.fail_from(0, 0, 0, 0)
        else:
            self._disk.fail_from(at, fault.error, fault.lasting, fault.hang_ms)

    async def live(self) -> LifeVerdict:
        """All runs; never raises but for mistakes of the bench."""
        for number in range(_RUNS):
            if number == _RUNS - 1:
                self._damage()
            for _ in range(_STARTS):
                if await self._run(f"run {number}"):
                    break
                self.verdict.not_started += 1
                self._heal()
            else:
                self.verdict.wrong.append(f"run {number} does not start although the disk works")
        self._heal()
        try:
            self._judge()
        except (StoreError, sqlite3.Error) as error:
            self.verdict.wrong.append(f"what is left cannot be read: {error!r}")
        return self.verdict

    def _heal(self) -> None:
        """The disk works from now on."""
        if not self._healed:
            self._healed = True
            self.verdict.calls = self._disk.disk_call_names().decode()
            self.verdict.refused = self._disk.disk_faults()
            self._disk.fail_from(0, 0, 0, 0)

    def _damage(self) -> None:
        """The file says another version than it was written with; nothing of it is lost."""
        self._disk.pause_disk_faults(1)
        with closing(sqlite3.connect(self._path)) as connection:
            connection.execute("PRAGMA user_version = 3")
        self._disk.pause_disk_faults(0)

    async def _run(self, boot: str) -> bool:
        """One run of a gateway; whether it started."""
        first, started = len(self._made), False
        try:
            with ExitStack() as stack:
                store = stack.enter_context(
                    Store(
                        self._path, f"{boot} {first} {self.verdict.not_started}", self._clock, commit_s=0.01,
                        retention=Retention(samples_days=0.01, minutes_days=0.01), retry_s=0.01,
                        hangs_after_s=_LIMIT_S, silent_s=_LIMIT_S,
                    )
                )  # fmt: skip
                past = past_in(store, self._config)
                store.begin(self._config.canonical(), self._config.fingerprint(), "")
                started = True
                await self._serve(store, Service, past)
        except (StoreError, OSError) as error:
            if not started:
                return False
            said = re.search(r"(\d+) rows were not stored", str(error))
            if said is None:
                self.verdict.wrong.append(f"{boot}: the end says not what is lost: {error!r}")
            else:
                self.verdict.told_lost += int(said[1])
            self._lost.update(self._made[first:])
        except Exception as error:  # noqa: BLE001 - whatever it is, it is the result
            self.verdict.wrong.append(f"{boot}: {'runs' if started else 'starts'}: {error!r}")
            return started
        if started and self._in_force() != (0.0, 0.0, 0.0):
            self.verdict.wrong.append(f"{boot}: stopped with {self._in_force()} in force")
        return True

    async def _serve(self, store: Store, service_of: type[Service], past: object) -> None:
        keeper = SnapshotKeeper(past, store, self._config, every_steps=4)  # type: ignore[arg-type]

        async def on_disk() -> None:
            with self._clock.hold():
                await store.on_disk(_LIMIT_S)

        with patch("gateway.service.control_of", lambda *_: InProcess(self._nck, self._clock)):
            service = service_of(
                self._config, self._clock, in_order([store.record, self._note, keeper.take]), past,  # type: ignore[arg-type]
                health=lambda: store.health, identity=Identity.of(str(len(self._made)), store.earlier_boot),
                on_disk=on_disk,
            )  # fmt: skip
        stop = asyncio.Event()
        running = asyncio.create_task(service.run(stop))
        failing_steps = 0
        try:
            for n in range(_STEPS_A_RUN):
                for i in range(3):
                    store.record(reading(10 * len(self._made) + i))
                await self._clock.run_until(self._clock.monotonic() + _STEP_S)
                if running.done():
                    break
                self._settle(store)
                self._plant.errors["EZ0A"] = _OFFSET_UM
                if store.health.problem:
                    failing_steps += 1
                    self.verdict.unstored += 1
                    if failing_steps == _HEALED_AFTER_STEPS:
                        self._check_state(n)
                        self._heal()
                        await self._recovered(store)
        finally:
            stop.set()
            ending = asyncio.ensure_future(running)
            while not ending.done():
                await self._clock.run_until(self._clock.monotonic() + _PERIOD_S)
            await ending

    def _settle(self, store: Store) -> None:
        """Wait for the store's thread, so that each life makes the same calls."""
        if self._fault is not None and self._fault.error == HANGS_ONCE:
            return
        with suppress(StoreError):  # the health says it
            store.flush()

    def _check_state(self, step: int) -> None:
        """Nothing could be stored for two steps."""
        wanted = {True: (0.0, _OFFSET_UM), False: (0.0,)}[self._config.storage.compensate_unstored]
        z = self._in_force()[2]
        if not any(abs(z - one) < 1.0 for one in wanted):
            self.verdict.wrong.append(f"step {step}: {z:g} µm in force while nothing can be stored, not {wanted}")

    async def _recovered(self, store: Store) -> None:
        """Wait in real time until it stores again, by itself."""
        for _ in range(_LIMIT_S * 100):
            health = store.health
            if not health.problem and not health.waiting:
                return
            await asyncio.sleep(0.01)
        self.verdict.wrong.append(f"the disk works, and the store says {store.health}")

    def _note(self, event: GatewayEvent) -> None:
        if isinstance(event, DecisionMade):
            self._made.append(event.decision.k)

    def _in_force(self) -> tuple[float, float, float]:
        self._nck.advance(self._clock.monotonic())
        x, y, z = (round(-1e3 * value, 6) + 0.0 for value in self._nck.k0_mm)
        return x, y, z

    def _judge(self) -> None:
        """Of the control's record and of the store that is left."""
        wrong = self.verdict.wrong
        try:
            assert_never_stepped(self._nck.log, (50.0, 50.0, 50.0), 1.0, _PERIOD_S)
        except AssertionError as error:
            wrong.append(f"a step: {error}")
        wrong += damage_found(self._path)
        with History(self._path) as history:
            steps = [step.frame.k for step in history.steps()]
            result = replay(history)
        if not result.identical:
            wrong.append(f"replay: {result.first}")
        if len(set(self._made)) != len(self._made):
            wrong.append(f"steps were decided twice: {self._made}")
        if missing := sorted(set(self._made) - set(steps) - self._lost):
            wrong.append(f"steps {missing} of {self._made} are not stored, and nothing told it")


def lives(folder: Path) -> None:
    """As a program: for each line `number of the fault or -1, call` on standard input, a life; its verdict as JSON."""
    for number, line in enumerate(sys.stdin):
        which, at, hang_ms = map(int, line.split())
        read, write = os.pipe()
        pid = os.fork()
        if not pid:
            os.close(read)
            faulthandler.dump_traceback_later(_LIMIT_S, exit=True)
            here = folder / f"{number} {which} {at}"
            here.mkdir()
            fault = (
                None if which < 0 else (*FAULTS, DiskFault("hangs", HANGS_ONCE, lasting=True, hang_ms=hang_ms))[which]
            )
            try:
                verdict = asyncio.run(Life(here, fault, at).live())
            except BaseException as error:  # noqa: BLE001 - the parent reports it
                verdict = LifeVerdict(wrong=[f"the bench: {error!r}"])
            with os.fdopen(write, "w") as pipe:
                pipe.write(json.dumps(asdict(verdict)))
            os._exit(0)
        os.close(write)
        with os.fdopen(read) as pipe:
            text = pipe.read()
        os.waitpid(pid, 0)
        print(text or json.dumps(asdict(LifeVerdict(wrong=["the process has ended or hung"]))), flush=True)


class LivesProcess:
    """Starts lives quickly: everything is imported once, each life is a fork. As a context manager."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder.resolve()

    def __enter__(self) -> "LivesProcess":
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.benches.disk_calls", "--lives", str(self._folder)],
            cwd=ROOT,
            env={
                **os.environ,
                "OPENBLAS_NUM_THREADS": "1",
                "LD_PRELOAD": str(preload(_SOURCE)),
                "FAILING_DISK": str(self._folder),
            },
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        return self

    def __exit__(self, *_: object) -> None:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()

    def life(self, which: int = -1, at: int = 0, hang_ms: int = 0) -> LifeVerdict:
        """A life with the fault of this number (-1: none; after the last: one synchronisation hangs)."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(f"{which} {at} {hang_ms}\n")
        self._process.stdin.flush()
        line = self._process.stdout.readline()
        assert line, "the process with the lives has ended"
        return LifeVerdict(**json.loads(line))


def _row(name: str, verdicts: Sequence[LifeVerdict]) -> str:
    reached = [v for v in verdicts if v.refused]
    return (
        f"| {name} | {len(reached)} | {sum(v.refused for v in reached)} | {sum(v.not_started for v in reached)} "
        f"| {sum(v.unstored > 0 for v in reached)} | {sum(v.told_lost > 0 for v in reached)} "
        f"| {sum(bool(v.wrong) for v in verdicts)} |"
    )


@click.command()
@click.option("--step", default=1, show_default=True, help="Each so many calls.")
@click.option("--hang-ms", default=300, show_default=True)
@click.option("--lives", "folder", type=click.Path(path_type=Path), hidden=True)
def main(step: int, hang_ms: int, folder: Path | None) -> None:
    """Let a gateway live once for each fault and each call, and print what became of it."""
    if folder is not None:
        lives(folder)
        return
    wrong = Counter[str]()
    with tempfile.TemporaryDirectory() as name, LivesProcess(Path(name)) as process:
        whole = process.life()
        kinds = ", ".join(f"{_WORDS[kind]} {count}" for kind, count in Counter(whole.calls).most_common())
        click.echo(f"{datetime.now(UTC):%Y-%m-%d}: {len(whole.calls)} calls: {kinds}")
        click.echo("\n".join(whole.wrong))
        click.echo("| fault | lives | calls refused | starts refused | went on unstored | said what is lost | wrong |")
        for which, named in enumerate((*(fault.name for fault in FAULTS), f"one hangs {hang_ms} ms")):
            verdicts = []
            for at in range(1, len(whole.calls) + 1, step):
                if which == len(FAULTS) and whole.calls[at - 1] != "s":
                    continue
                verdicts.append(process.life(which, at, hang_ms))
                for text in verdicts[-1].wrong:
                    wrong[text] += 1
                    if wrong[text] <= 3:
                        click.echo(f"{named}, call {at} ({whole.calls[at - 1]}): {text}", err=True)
            click.echo(_row(named, verdicts))
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
