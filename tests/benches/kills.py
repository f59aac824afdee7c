"""A gateway that is killed while it starts, rebuilds, learns, probes, writes and stops, again and again.

The moment of death is a number: while writing, of the call that changes the disk; while probing, of the call to the
control; otherwise of a call or return of the gateway's code in the main thread. Ten lives have one database, and one
more that is not killed; between two of them the control goes on alone. Each life is a fork of a process in which a
whole life has passed already, so that no time goes into loading libraries.

`python -m tests.benches.kills --writing 200 --phase 20` prints a table. Exit code 1: something is wrong.
"""

import ctypes
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import click

from gateway.control.replay.stored import replay
from gateway.runtime.garbage import freeze_gc
from gateway.storage.damage import damage_found
from gateway.storage.history import History
from simulators.nc import Activity, CycleSettings, DayPart, LoadCase, MeanLoads
from tests.benches.death import PHASES, Death
from tests.benches.failing_disk import on_failing_disk
from tests.benches.killed_life import LIMIT_S, PERIOD_S, GatewayLife, SwingingPlant
from tests.benches.outlives import KeptNck, SharedMemory, WhatOutlives
from tests.benches.wire_bench import assert_never_stepped

WRITING = "writing"
_LIVES_A_DATABASE = 10
_KILLS = -3
"""The fault of failing_disk.cc that kills."""
_ALONE_S = (0.0, 5.0, 30.0, 100.0, 1000.0)
"""How long the control may be alone after a life; after the longest its watchdog has taken all offsets away."""


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
        """One life, which ends by itself or is killed in a phase; then the control is alone for a while."""
        self._lives += 1
        read, write = os.pipe()
        pid = os.fork()
        if not pid:
            self._child(phase, at, write)
        os.close(write)
        end_s = time.monotonic() + LIMIT_S
        while (ended := os.waitpid(pid, os.WNOHANG))[0] == 0:
            if time.monotonic() > end_s:
                os.kill(pid, signal.SIGKILL)
                os.waitpid(pid, 0)
                raise TimeoutError(f"life {self._lives} did not end within {LIMIT_S:g} s")
            time.sleep(0.005)
        with os.fdopen(read) as pipe:
            told = pipe.read()
        if os.WIFSIGNALED(ended[1]) and os.WTERMSIG(ended[1]) == signal.SIGKILL:
            verdict = KillVerdict(killed=True)
        else:
            verdict = KillVerdict(**json.loads(told or '{"wrong": "it ended without a word"}'))
        left, alone_s = self._memory.kept(), self._draw.choice(_ALONE_S)
        left.now_s += alone_s
        left.nck.advance(left.now_s)
        self._memory.keep(left)
        if alone_s == max(_ALONE_S) and any(left.nck.k0_mm):
            verdict.wrong += f" {alone_s:g} s after life {self._lives} the control still adds {left.nck.k0_mm} mm"
        return verdict

    def rehearse(self) -> None:
        """A life in this process, of which the next ones are forks."""
        self._disk.fail_from(0, 0, 0)
        GatewayLife(self._folder, self._memory, self._lives, Death(WRITING, 0), self._draw).live()
        assert threading.active_count() == 1, threading.enumerate()
        freeze_gc()

    def _child(self, phase: str | None, at: int, write: int) -> None:
        """Does not return."""
        wrong, death = "", Death(phase, at)
        self._disk.fail_from(at if phase == WRITING else 0, _KILLS, 0)
        try:
            GatewayLife(self._folder, self._memory, self._lives, death, self._draw).live()
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
        """Judge the control's record and the database; returns what is wrong."""
        left, path, wrong = self._memory.kept(), self._folder / "g.sqlite", list[str]()
        try:
            assert_never_stepped(left.nck.log, (50.0, 50.0, 50.0), 1.0, PERIOD_S)
        except AssertionError as error:
            wrong.append(f"a step: {error}")
        if len(set(left.requests)) != len(left.requests):
            wrong.append(f"a number was used twice: {left.requests}")
        if left.nck.moved_in_cycle:
            wrong.append(f"an offset was changed {left.nck.moved_in_cycle} times while the control probed")
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
    """The counts of one phase."""

    wanted: int
    killed: int = 0
    not_reached: int = 0


def _moments(folder: Path) -> dict[str, int]:
    """How many moments of death each phase has in a life that is not the first."""
    folder.mkdir()
    machine = KilledMachine(folder, random.Random(0))
    machine.rehearse()
    for _ in range(2):
        verdict = machine.life()
        assert not verdict.wrong, verdict.wrong
    assert all(verdict.counts.values()), verdict.counts
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
    """Kill this many in each phase; returns the counts and how many things were wrong, and prints those."""
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
@click.option("--only", multiple=True, type=click.Choice((WRITING, *PHASES)), help="Kill only in these phases.")
@click.option("--seed", default=0, show_default=True)
def main(writing: int, phase: int, only: Sequence[str], seed: int) -> None:
    """Kill gateways and print what became of them."""
    with tempfile.TemporaryDirectory() as name:
        if "FAILING_DISK" not in os.environ:  # the layer that counts the calls must be there before Python
            command = [sys.executable, "-m", "tests.benches.kills", *sys.argv[1:]]
            sys.exit(subprocess.run(command, env=on_failing_disk(Path(name)), check=False).returncode)
    folder, wanted = Path(os.environ["FAILING_DISK"]), {WRITING: writing, **dict.fromkeys(PHASES, phase)}
    counts, wrong = kill_gateways({name: wanted[name] for name in only or wanted}, seed, folder)
    click.echo("| phase | killed | ended by itself before |\n|---|---|---|")
    for name, count in counts.items():
        click.echo(f"| {name} | {count.killed} | {count.not_reached} |")
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
