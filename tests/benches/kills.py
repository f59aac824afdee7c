"""A gateway that is killed while it starts, rebuilds, learns, probes, writes and stops, again and again.

The gateway is the whole service with its store. Its control is the emulated one; what the gateway writes to it outlives
the gateway. Time is simulated, so the moment of death is a number: while writing, of the call that changes the disk;
while probing, of the call to the control; otherwise of the main thread's call or return. Ten lives have one database,
and one more that is not killed; between two of them the control goes on alone.

`python -m tests.benches.kills --writing 200 --phase 20` prints a table. Exit code 1: something is wrong.
"""

import asyncio
import ctypes
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from unittest.mock import patch

import click
import numpy as np

from drivers.nc import NcSnapshot, RequestStatus
from gateway.events import DecisionMade, GatewayEvent, in_order
from gateway.nc import Identity
from gateway.past import SnapshotKeeper, past_in
from gateway.replay import replay
from gateway.service import Service
from gateway.storage import History, Store, damage_found
from simulators.nc import Activity, CycleSettings, DayPart, LoadCase, MeanLoads
from simulators.nc.nck import Nck
from talc.control import Controller
from talc.frame import Decision, Frame
from tests.benches.death import PHASES, PROBING, Death
from tests.benches.disk_calls import config_in
from tests.benches.emulated_bench import expected_deviation_um
from tests.benches.failing_disk import on_failing_disk
from tests.benches.in_process_nc import InProcess
from tests.benches.outlives import KeptNck, SharedMemory, WhatOutlives
from tests.benches.spoilt_stores import reading
from tests.benches.wire_bench import assert_never_stepped
from tests.benches.wire_clock import WireClock

WRITING = "writing"
_STEP_S, _PERIOD_S, _STEPS_A_LIFE, _LIVES_A_DATABASE = 300.0, 10.0, 4, 10
_KILLS = -3
"""The fault of failing_disk.cc that kills."""
_LIMIT_S = 600.0  # real time for one life; it takes about a second


class SwingingPlant:
    """A machine whose errors follow the time, so that every gateway has something to correct."""

    def tool_deviation_um(
        self, time_s: float, x_mm: float, y_mm: float, z_mm: float, a_deg: float, c_deg: float
    ) -> tuple[float, float, float]:
        errors = {"EZ0A": 20.0 * np.sin(time_s / 1500.0), "EX0C": 12.0 * np.sin(time_s / 2100.0)}
        x, y, z = expected_deviation_um(errors, a_deg, c_deg)
        return float(x), float(y), float(z)


class KeptControl(InProcess):
    """The control as the gateway sees it; a cycle is the phase `probing`."""

    def __init__(self, nck: Nck, clock: WireClock, requests: list[int], death: Death) -> None:
        super().__init__(nck, clock)
        self._requests, self._death = requests, death

    async def request_probing(self, number: int) -> None:
        self._death.begin(PROBING)
        self._requests.append(number)
        await super().request_probing(number)
        self._death.asks_control()

    async def probing_status(self, number: int) -> RequestStatus:
        self._death.asks_control()
        return await super().probing_status(number)

    async def snapshot(self) -> NcSnapshot:
        self._death.asks_control()
        return await super().snapshot()

    async def heartbeat(self, owner: int) -> bool:
        self._death.asks_control()
        return await super().heartbeat(owner)


class GatewayLife:
    """One run of a gateway on what the ones before left, in a process of its own."""

    def __init__(self, folder: Path, memory: SharedMemory, number: int, death: Death, draw: random.Random) -> None:
        self._config, self._name = config_in(folder, continues=True), f"life {number}"
        self._memory, self._death, self._draw = memory, death, draw
        self._left, self._clock = memory.kept(), WireClock()
        self._first = len(self._left.decided)
        """Of those that it decides itself; what an earlier one decided may have died with it."""
        self._clock.spend(self._left.now_s)
        self._clock.started_as = "the computer was not switched off"
        KeptNck.changed = self._keep

    def _keep(self) -> None:
        self._left.now_s = self._clock.monotonic()
        self._memory.keep(self._left)

    async def live(self) -> None:
        """Start, do some steps, stop."""
        death, step = self._death, Controller.step

        def learning(controller: Controller, frame: Frame) -> Decision:
            if frame.measurement is None:
                return step(controller, frame)
            death.end(PROBING)
            with death.within("learning"):
                return step(controller, frame)

        with ExitStack() as stack:
            with death.within("start"):
                store = Store(
                    self._config.storage.path, self._name, self._clock, commit_s=0.01, retry_s=0.01,
                    hangs_after_s=_LIMIT_S, silent_s=_LIMIT_S,
                )  # fmt: skip
                stack.enter_context(store)
            with death.within("rebuild"):
                past = past_in(store, self._config)
            assert not store.health.mended, store.health.mended
            stack.enter_context(patch.object(Controller, "step", learning))
            with death.within("start"):
                store.begin(self._config.canonical(), self._config.fingerprint(), "")
                keeper = SnapshotKeeper(past, store, self._config, every_steps=4)
                control = KeptControl(self._left.nck, self._clock, self._left.requests, death)
                with patch("gateway.service.control_of", lambda *_: control):
                    sinks = self._note, store.record, partial(self._flush, store), keeper.take
                    service = Service(
                        self._config, self._clock, in_order(sinks), past,
                        health=lambda: store.health, identity=Identity.of(self._name, store.earlier_boot),
                        on_disk=partial(self._on_disk, store),
                    )  # fmt: skip
            await self._run(service, store)
            death.begin("stop")
        death.end("stop")
        self._all_stored()

    def _all_stored(self) -> None:
        self._left.stored = sorted({*self._left.stored, *self._left.decided[self._first :]})
        self._keep()

    async def _run(self, service: Service, store: Store) -> None:
        stop = asyncio.Event()
        running = asyncio.create_task(service.run(stop))
        for _ in range(_STEPS_A_LIFE):
            for i in range(3):
                store.record(reading(10 * len(self._left.decided) + i))
            await self._clock.run_until(self._clock.monotonic() + _STEP_S)
            assert not running.done(), running
        self._death.end(PROBING)
        with self._death.within("stop"):
            stop.set()
            while not running.done():
                await self._clock.run_until(self._clock.monotonic() + _PERIOD_S)
            await running

    async def _on_disk(self, store: Store) -> None:
        with self._clock.hold():
            await store.on_disk(_LIMIT_S)

    def _flush(self, store: Store, event: GatewayEvent) -> None:
        """Half of the decisions are waited for, at once: a commit that comes later than it says is then found."""
        if isinstance(event, DecisionMade) and self._draw.random() < 0.5:
            store.flush()
            self._all_stored()

    def _note(self, event: GatewayEvent) -> None:
        if isinstance(event, DecisionMade):
            self._left.decided.append(event.decision.k)
            self._keep()


@dataclass(slots=True)
class KillVerdict:
    """What became of one life."""

    killed: bool = False
    wrong: str = ""
    counts: dict[str, int] = field(default_factory=dict)
    """How many moments of death each phase has had."""


class KilledMachine:
    """One control and one database, and the gateways that live on it, one after another."""

    def __init__(self, folder: Path, draw: random.Random) -> None:
        self._folder, self._draw, self._memory, self._lives = folder, draw, SharedMemory(), 0
        rest = LoadCase([DayPart(0.0, 1e12, Activity.PAUSE, MeanLoads())])
        self._memory.keep(WhatOutlives(KeptNck(SwingingPlant(), rest, cycle=CycleSettings(noise_um=0.0))))
        self._disk = ctypes.CDLL(None)
        self._disk.disk_call_names.restype = ctypes.c_char_p

    def life(self, phase: str | None = None, at: int = 0) -> KillVerdict:
        """One, which ends by itself or in a phase; then the control is alone for a while."""
        self._lives += 1
        read, write = os.pipe()
        pid = os.fork()
        if not pid:
            self._child(phase, at, write)
        os.close(write)
        end_s = time.monotonic() + _LIMIT_S
        while (ended := os.waitpid(pid, os.WNOHANG))[0] == 0:
            if time.monotonic() > end_s:
                os.kill(pid, signal.SIGKILL)
                os.waitpid(pid, 0)
                raise TimeoutError(f"life {self._lives} did not end within {_LIMIT_S:g} s")
            time.sleep(0.005)
        with os.fdopen(read) as pipe:
            told = pipe.read()
        if os.WIFSIGNALED(ended[1]) and os.WTERMSIG(ended[1]) == signal.SIGKILL:
            verdict = KillVerdict(killed=True)
        else:
            verdict = KillVerdict(**json.loads(told or '{"wrong": "it ended without a word"}'))
        left = self._memory.kept()
        left.now_s += self._draw.choice((0.0, 5.0, 30.0, 100.0, 1000.0))
        left.nck.advance(left.now_s)
        self._memory.keep(left)
        return verdict

    def _child(self, phase: str | None, at: int, write: int) -> None:
        """Does not return."""
        wrong, death = "", Death(phase, at)
        self._disk.fail_from(at if phase == WRITING else 0, _KILLS, 0, 0)
        try:
            asyncio.run(GatewayLife(self._folder, self._memory, self._lives, death, self._draw).live())
        except BaseException as error:  # noqa: BLE001 - whatever it is, it is the result
            sys.setprofile(None)
            wrong = f"life {self._lives}: {error!r}"
        counts = death.counts | {WRITING: len(self._disk.disk_call_names())}
        with os.fdopen(write, "w") as pipe:
            pipe.write(json.dumps({"wrong": wrong, "counts": counts}))
        os._exit(0)

    @property
    def moved(self) -> bool:
        """Whether a gateway has changed the offsets, not the control's watchdog alone."""
        return any(not entry.ramped for entry in self._memory.kept().nck.log)

    def judged(self) -> list[str]:
        """What is wrong with the record of the control and with the database."""
        left, path, wrong = self._memory.kept(), self._folder / "g.sqlite", list[str]()
        try:
            assert_never_stepped(left.nck.log, (50.0, 50.0, 50.0), 1.0, _PERIOD_S)
        except AssertionError as error:
            wrong.append(f"a step: {error}")
        if len(set(left.requests)) != len(left.requests):
            wrong.append(f"a number was used twice: {left.requests}")
        wrong += damage_found(path)
        with History(path) as history:
            steps = [step.frame.k for step in history.steps()]
            result = replay(history)
        if not result.identical:
            wrong.append(f"replay: {result.first}")
        if missing := sorted(set(left.stored) - set(steps)):
            wrong.append(f"steps {missing} of {left.decided} were said to be stored and are not among {steps}")
        if unknown := sorted(set(steps) - set(left.decided)):
            wrong.append(f"steps {unknown} are stored, and nobody has decided them")
        return wrong


@dataclass(slots=True)
class KillCount:
    """Of one phase."""

    wanted: int
    killed: int = 0
    not_reached: int = 0


def _moments(folder: Path) -> dict[str, int]:
    """How many moments of death each phase has, of a life that is not the first."""
    folder.mkdir()
    machine = KilledMachine(folder, random.Random(0))
    for _ in range(2):
        verdict = machine.life()
        assert not verdict.wrong, verdict.wrong
    return verdict.counts


def _lived(
    machine: KilledMachine, counts: dict[str, KillCount], moments: dict[str, int], draw: random.Random
) -> list[str]:
    """Some lives that are killed, and one that is not; what is wrong."""
    wrong = list[str]()
    for _ in range(_LIVES_A_DATABASE):
        due = [phase for phase, count in counts.items() if count.killed < count.wanted]
        if not due:
            break
        phase = draw.choice(due)
        verdict = machine.life(phase, draw.randint(1, moments[phase]))
        counts[phase].killed += verdict.killed
        counts[phase].not_reached += not verdict.killed
        wrong += [f"{phase}: {verdict.wrong}"] if verdict.wrong else []
    last = machine.life()
    return wrong + ([last.wrong] if last.wrong else []) + machine.judged()


def kill_gateways(wanted: dict[str, int], seed: int, folder: Path) -> tuple[dict[str, KillCount], int]:
    """Kill so many in each phase; the counts, and how many things were wrong, which are printed."""
    counts, databases, moved, wrong = {phase: KillCount(count) for phase, count in wanted.items()}, 0, 0, 0
    moments = _moments(folder / "first")
    click.echo(f"moments of death: {', '.join(f'{name} {count}' for name, count in moments.items())}")
    while any(count.killed < count.wanted for count in counts.values()):
        draw = random.Random(1_000_003 * seed + databases)
        with tempfile.TemporaryDirectory(dir=folder) as name:
            machine = KilledMachine(Path(name), draw)
            try:
                texts = _lived(machine, counts, moments, draw)
            except Exception as error:  # noqa: BLE001 - whatever it is, it is the result
                texts = [repr(error)]
        for text in texts:
            click.echo(f"database {databases} of seed {seed}: {text}")
        wrong += len(texts)
        moved += machine.moved
        databases += 1
    click.echo(f"{datetime.now(UTC):%Y-%m-%d}: {databases} databases, offsets moved in {moved}, {wrong} wrong")
    wrong += 2 * moved < databases  # then it has shown nothing about steps
    return counts, wrong


@click.command()
@click.option("--writing", default=200, show_default=True, help="Kills at a call that changes the disk.")
@click.option("--phase", default=20, show_default=True, help="Kills in each of the other phases.")
@click.option("--seed", default=0, show_default=True)
def main(writing: int, phase: int, seed: int) -> None:
    """Kill gateways and print what became of them."""
    with tempfile.TemporaryDirectory() as name:
        if "FAILING_DISK" not in os.environ:  # the layer that counts the calls must be there before Python
            command = [sys.executable, "-m", "tests.benches.kills", *sys.argv[1:]]
            sys.exit(subprocess.run(command, env=on_failing_disk(Path(name)), check=False).returncode)
    folder = Path(os.environ["FAILING_DISK"])
    counts, wrong = kill_gateways({WRITING: writing, **dict.fromkeys(PHASES, phase)}, seed, folder)
    click.echo("| phase | killed | ended by itself before |\n|---|---|---|")
    for name, count in counts.items():
        click.echo(f"| {name} | {count.killed} | {count.not_reached} |")
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
