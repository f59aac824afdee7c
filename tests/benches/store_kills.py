"""A writer of the database that is killed while it writes, thousands of times.

Each life is a separate process: it opens the store, continues with the controller that the previous life left, and
writes steps with readings, events, measurements and snapshots, until it is killed with SIGKILL at a random call that
changes the disk, from the first of opening to the last of closing. What the store has reported as stored is kept in
shared memory. There is no control: `tests.benches.kills` kills whole gateways.

`python -m tests.benches.store_kills --count 20000` prints a table. Exit code 1: something is wrong.
"""

import ctypes
import logging
import mmap
import os
import random
import signal
import struct
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import click

from gateway.control.replay.stored import replay
from gateway.control.restart.earlier import past_in
from gateway.control.restart.rebuild import marks
from gateway.control.restart.snapshots import SnapshotKeeper
from gateway.storage.damage import damage_found
from gateway.storage.history import History
from gateway.storage.store import Store
from tests.benches.failing_disk import on_failing_disk
from tests.benches.service_file import two_temperatures
from tests.benches.spoilt_stores import reading, write
from tests.benches.stepped_clock import SteppedClock

_KILLS = -3
"""The fault of failing_disk.cc that kills."""
_LIVES_A_DATABASE, _STEPS_A_LIFE, _READINGS_A_STEP = 20, 5, 3
_LIMIT_S = 600.0  # real time for one life; it takes some hundredths of a second
_MOST_STEPS, _WRONG_SIZE = 256, 4096
_CALLS = struct.Struct("=q")


class ToldMemory:
    """What the lives of one database say, in memory that outlives them: steps that were reported as stored, calls, what
    is wrong."""

    def __init__(self) -> None:
        self._memory = mmap.mmap(-1, _MOST_STEPS + _CALLS.size + _WRONG_SIZE)

    def begin_database(self) -> None:
        """Nothing has been said yet."""
        self._memory[:] = bytes(len(self._memory))

    @property
    def steps(self) -> list[int]:
        """The steps that were reported as stored, with their readings and events, in order."""
        return [k for k in range(_MOST_STEPS) if self._memory[k]]

    def add(self, steps: Iterable[int]) -> None:
        for k in steps:
            self._memory[k] = 1

    @property
    def calls(self) -> int:
        """How often the last life that ended by itself changed the disk."""
        return int(_CALLS.unpack_from(self._memory, _MOST_STEPS)[0])

    @calls.setter
    def calls(self, count: int) -> None:
        _CALLS.pack_into(self._memory, _MOST_STEPS, count)

    @property
    def wrong(self) -> str:
        return self._memory[_MOST_STEPS + _CALLS.size :].rstrip(b"\0").decode(errors="replace")

    @wrong.setter
    def wrong(self, text: str) -> None:
        self._memory[_MOST_STEPS + _CALLS.size :] = text.encode()[:_WRONG_SIZE].ljust(_WRONG_SIZE, b"\0")


def _live(path: Path, number: int, told: ToldMemory) -> None:
    """One life; raises AssertionError for what the lives before should have left and have not."""
    settings, draw, clock = two_temperatures(path), random.Random(number), SteppedClock()
    with Store(
        path, f"life {number}", clock, commit_s=0.01, retry_s=0.01, hangs_after_s=_LIMIT_S, silent_s=_LIMIT_S
    ) as store:
        past = past_in(store, settings)
        assert not store.health.mended, store.health.mended
        last = -1 if past.last_k is None else past.last_k
        assert set(told.steps) <= set(range(last + 1)), (
            f"steps {told.steps} were reported as stored, {last} is the last"
        )
        store.begin(settings.canonical(), settings.fingerprint(), "")
        keeper = SnapshotKeeper(past, store, settings, every_steps=4)
        for k in range(last + 1, last + 1 + _STEPS_A_LIFE):
            for i in range(_READINGS_A_STEP):
                store.record(reading(k * _READINGS_A_STEP + i))
            write(store, past.controller, k, keeper.take)
            if draw.random() < 0.7:
                store.flush()
                told.add(range(last + 1, k + 1))
    told.add(range(last + 1, k + 1))


def _judged(path: Path, told: ToldMemory) -> Iterator[str]:
    """What is wrong with a database after all its lives."""
    yield from damage_found(path)
    with History(path) as history:
        steps = [step.frame.k for step in history.steps()]
        read = {int(row[-1]) for row in history.readings()}
        events = {k for _, k, event in history.events() if event.text.startswith("event ")}
        result = replay(history)
    if not result.identical:
        yield f"replay: {result.first}"
    if steps != list(range(len(steps))):
        yield f"the steps are {steps}"
    for k in told.steps:
        if k not in steps or k not in events:
            yield f"step {k}, or an event of it, was reported as stored"
        if lost := set(range(_READINGS_A_STEP * k, _READINGS_A_STEP * (k + 1))) - read:
            yield f"readings {sorted(lost)} were reported as stored"


@dataclass(slots=True)
class WriterKills:
    """How many lives ended how."""

    killed: int = 0
    ended: int = 0
    databases: int = 0
    wrong: list[str] = field(default_factory=list)


class KilledWriter:
    """The lives of writers, one database after another, in a folder on the disk whose calls are counted."""

    def __init__(self, folder: Path, seed: int) -> None:
        self._folder, self._seed, self._told, self._lives = folder, seed, ToldMemory(), 0
        self._disk = ctypes.CDLL(None)
        self._disk.disk_call_names.restype = ctypes.c_char_p
        marks(two_temperatures(folder / "g.sqlite"))  # once for all lives: it reads the program
        with self._database() as path:
            for _ in range(2):
                assert not self._life(path, 0), self._told.wrong
        self.moments = self._told.calls
        """How many calls change the disk in a life that is not the first one."""

    @contextmanager
    def _database(self) -> Iterator[Path]:
        self._told.begin_database()
        with tempfile.TemporaryDirectory(dir=self._folder) as name:
            yield Path(name) / "g.sqlite"

    def _life(self, path: Path, at: int) -> bool:
        """One life; returns whether it was killed. 0: do not kill it."""
        self._lives += 1
        pid = os.fork()
        if not pid:
            self._child(path, at)
        _, status = os.waitpid(pid, 0)
        killed = os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGKILL
        if not killed and os.waitstatus_to_exitcode(status):
            self._told.wrong = self._told.wrong or f"it ended with status {status}"
        return killed

    def _child(self, path: Path, at: int) -> None:
        """Does not return."""
        status = 1
        try:
            self._disk.fail_from(at, _KILLS, 0, 0)
            _live(path, self._lives, self._told)
            self._told.calls = len(self._disk.disk_call_names())
            status = 0
        except BaseException as error:  # noqa: BLE001 - whatever it is, it is the result
            self._told.wrong = f"{error!r} {traceback.extract_tb(error.__traceback__)[-1]}"
        os._exit(status)

    def kill(self, count: int) -> WriterKills:
        """Kill this many, at random moments."""
        done = WriterKills()
        while done.killed < count:
            draw = random.Random(1_000_003 * self._seed + done.databases)
            with self._database() as path:
                for _ in range(min(_LIVES_A_DATABASE, count - done.killed)):
                    killed = self._life(path, draw.randint(1, self.moments))
                    done.killed, done.ended = done.killed + killed, done.ended + (not killed)
                    self._note(done)
                self._life(path, 0)
                self._note(done)
                done.wrong += [f"database {done.databases}: {text}" for text in _judged(path, self._told)]
            done.databases += 1
        return done

    def _note(self, done: WriterKills) -> None:
        if self._told.wrong:
            done.wrong.append(f"database {done.databases}, life {self._lives}: {self._told.wrong}")
            self._told.wrong = ""


def _print(done: WriterKills, moments: int, most: Sequence[str]) -> None:
    click.echo(f"{datetime.now(UTC):%Y-%m-%d}: calls that change the disk in a life: {moments}")
    click.echo("| killed | ended by itself before | databases | wrong |\n|---|---|---|---|")
    click.echo(f"| {done.killed} | {done.ended} | {done.databases} | {len(done.wrong)} |")
    click.echo("\n".join(most))


@click.command()
@click.option("--count", default=1000, show_default=True)
@click.option("--seed", default=0, show_default=True)
def main(count: int, seed: int) -> None:
    """Kill COUNT writers of a database and print what became of it."""
    with tempfile.TemporaryDirectory() as name:
        if "FAILING_DISK" not in os.environ:  # the layer that counts the calls must be there before Python
            command = [sys.executable, "-m", "tests.benches.store_kills", *sys.argv[1:]]
            sys.exit(subprocess.run(command, env=on_failing_disk(Path(name)), check=False).returncode)
    logging.disable(logging.CRITICAL)
    writer = KilledWriter(Path(os.environ["FAILING_DISK"]), seed)
    done = writer.kill(count)
    _print(done, writer.moments, done.wrong[:20])
    sys.exit(1 if done.wrong else 0)


if __name__ == "__main__":
    main()
