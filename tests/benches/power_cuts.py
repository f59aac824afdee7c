"""Power cuts: the disk as it could be left at any moment while a gateway writes, and a gateway that starts on it.

A layer under the process (`power_cut.cc`) records what it does to its files. From the record a disk is rebuilt: what
was synchronised is there; each page that was written later is as it was after some of its writes, whatever came of the
others, and may be torn between two sectors. Names of files follow a journal: they appear in the order in which they
were made.

`python -m tests.benches.power_cuts --count 1000` prints a table.
"""

import ctypes
import os
import random
import sqlite3
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import click

from gateway.control.replay.stored import replay
from gateway.control.restart.earlier import earlier_run
from gateway.control.restart.snapshots import SnapshotKeeper
from gateway.storage.damage import damage_found
from gateway.storage.history import History
from gateway.storage.store import Store
from tests.benches.preloads import preload
from tests.benches.service_file import two_temperatures
from tests.benches.spoilt_stores import reading, write
from tests.benches.stepped_clock import SteppedClock

ROOT = Path(__file__).parents[2]
_SOURCE = Path(__file__).with_name("power_cut.cc")
_HEAD = struct.Struct("=QQqQd")
PAGE, SECTOR = 4096, 512
COMMIT_S = 0.1
"""The session's commit interval."""
_STEPS_A_RUN, _READINGS_A_STEP, _PAUSE_S = 150, 4, 0.002
_HANDED, _TOLD = 1, 2
_NAME = "g.sqlite"


class DiskAct(NamedTuple):
    """One thing that the process did: n: a file was made or opened, w: written, t: cut, s: synchronised, u: its name
    was removed, m: a mark."""

    what: str
    file: int
    at: int
    data: bytes
    seconds: float


@dataclass
class DiskFile:
    """What of a file is on the disk for certain, and what may be."""

    certain: bytearray = field(default_factory=bytearray)
    pending: list[tuple[int, bytes | None]] = field(default_factory=list)
    """Place and data; None: cut there."""

    def sync(self) -> None:
        for at, data in self.pending:
            _apply(self.certain, at, data)
        self.pending.clear()

    def left(self, draw: random.Random) -> bytearray:
        """What is on the disk after the power was cut: each page as it was after some of its writes."""
        content = bytearray(self.certain)
        mood = draw.choice((0.0, 0.1, 0.5, 0.9, 1.0))
        pages: dict[int, list[tuple[int, bytes]]] = {}
        for at, data in self.pending:
            if data is not None:
                for place, piece in _split(at, data, PAGE):
                    pages.setdefault(place // PAGE, []).append((place, piece))
            elif draw.random() < mood:
                _write_back(content, pages, draw, mood)
                pages.clear()
                _apply(content, at, None)
        _write_back(content, pages, draw, mood)
        return content


def _write_back(
    content: bytearray, pages: Mapping[int, Sequence[tuple[int, bytes]]], draw: random.Random, mood: float
) -> None:
    for writes in pages.values():
        done = len(writes) if draw.random() < mood else draw.randint(0, len(writes))
        for place, piece in writes[:done]:
            _apply(content, place, piece)
        if done < len(writes) and draw.random() < 0.3:  # torn in the middle of the next one
            for place, sector in _split(*writes[done], SECTOR):
                if draw.random() < 0.5:
                    _apply(content, place, sector)


def _split(at: int, data: bytes, size: int) -> Iterator[tuple[int, bytes]]:
    """Pieces that end where multiples of `size` are."""
    begin = 0
    while begin < len(data):
        end = min(len(data), begin + size - (at + begin) % size)
        yield at + begin, data[begin:end]
        begin = end


def _apply(content: bytearray, at: int, data: bytes | None) -> None:
    if data is None:
        if at < len(content):
            del content[at:]
        else:
            content.extend(bytes(at - len(content)))
        return
    if len(content) < at:
        content.extend(bytes(at - len(content)))
    content[at : at + len(data)] = data


def read_log(path: Path) -> list[DiskAct]:
    """All acts, in order."""
    data, acts, at = path.read_bytes(), list[DiskAct](), 0
    while at < len(data):
        what, file, place, size, seconds = _HEAD.unpack_from(data, at)
        at += _HEAD.size
        acts.append(DiskAct(chr(what), file, place, data[at : at + size], seconds))
        at += size
    return acts


def recorded(folder: Path) -> list[DiskAct]:
    """A session of two runs in a separate process; returns what it did to its disk."""
    disk, log = folder / "disk", folder / "log"
    disk.mkdir()
    subprocess.run(
        [sys.executable, "-m", "tests.benches.power_cuts", "--session", str(disk)],
        cwd=ROOT,
        env={
            **os.environ,
            "OPENBLAS_NUM_THREADS": "1",
            "LD_PRELOAD": str(preload(_SOURCE)),
            "POWER_CUT_FOLDER": str(disk.resolve()),
            "POWER_CUT_LOG": str(log),
        },
        check=True,
    )
    return read_log(log)


def session(folder: Path) -> None:
    """Two runs of a gateway's store, with readings, steps and snapshots. The first one ends in order."""
    mark = ctypes.CDLL(None).power_cut_mark
    mark.argtypes = [ctypes.c_int64, ctypes.c_int64]
    config = two_temperatures(folder / _NAME)
    for run in range(2):
        with Store(config.storage.path, f"run {run}", SteppedClock(), commit_s=COMMIT_S) as store:
            past = earlier_run(store, config)
            store.begin(config.canonical(), config.fingerprint(), "")
            keeper = SnapshotKeeper(past, store, config, every_steps=40)
            first = 0 if past.last_k is None else past.last_k + 1
            for k in range(first, first + _STEPS_A_RUN):
                for i in range(_READINGS_A_STEP):
                    store.record(reading(k * _READINGS_A_STEP + i))
                    mark(_HANDED, k * _READINGS_A_STEP + i)
                    time.sleep(_PAUSE_S)
                write(store, past.controller, k, keeper.take)
                if k % 7 == 0:
                    store.flush()
                    mark(_TOLD, k)


def rebuilt_disk(acts: Sequence[DiskAct], draw: random.Random, folder: Path) -> None:
    """Write the files as a power cut after these acts could leave them."""
    files: dict[int, DiskFile] = {}
    names: dict[str, int] = {}
    later: list[tuple[str, int | None]] = []
    """Names that are not certain yet; None: removed."""
    for act in acts:
        if act.what == "n" and act.at == 0:  # else it was there before
            files[act.file] = DiskFile()
        if act.what in "nu":
            later.append((Path(act.data.decode()).name, act.file if act.what == "n" else None))
        elif act.what in "wt":
            files.setdefault(act.file, DiskFile()).pending.append((act.at, act.data if act.what == "w" else None))
        elif act.what == "s":  # commits the file system's journal, too
            files.setdefault(act.file, DiskFile()).sync()
            _name(names, later)
            later.clear()
    _name(names, later[: draw.randint(0, len(later))])
    for name, file in names.items():
        if not name.endswith("-shm"):  # made again when the database is opened
            (folder / name).write_bytes(files[file].left(draw))


def _name(names: dict[str, int], changes: Sequence[tuple[str, int | None]]) -> None:
    for name, file in changes:
        if file is None:
            names.pop(name, None)
        else:
            names[name] = file


@dataclass
class StartVerdict:
    """What a gateway found after a power cut."""

    wrong: list[str] = field(default_factory=list)
    lost_s: float = 0.0
    """The time span of what was handed in last and lost, s."""
    pending: bool = False
    """Whether anything was written and not synchronised."""


def cut_and_start(acts: Sequence[DiskAct], seed: int, folder: Path) -> StartVerdict:
    """Cut the power at a moment that the seed chooses, and start a gateway on what is left."""
    draw, verdict = random.Random(seed), StartVerdict()
    passed = acts[: draw.randrange(1, len(acts) + 1)]
    rebuilt_disk(passed, draw, folder)
    told = max((act.at for act in passed if act.what == "m" and act.file == _TOLD), default=-1)
    handed = {act.at: act.seconds for act in passed if act.what == "m" and act.file == _HANDED}
    verdict.pending = passed[-1].what in "wt"
    config = two_temperatures(folder / _NAME)
    with Store(config.storage.path, "after", SteppedClock(), commit_s=0.01) as store:
        past = earlier_run(store, config)
        store.begin(config.canonical(), config.fingerprint(), "")
        mended = store.health.mended
        last = -1 if past.last_k is None else past.last_k
        for k in range(last + 1, last + 4):
            write(store, past.controller, k)
    if mended or list(folder.glob("*damaged*")):
        verdict.wrong.append(f"torn: {mended}")
    if last < told:
        verdict.wrong.append(f"step {told} was reported as stored, and {last} is the last one")
    verdict.wrong += damage_found(config.storage.path)
    try:
        with History(config.storage.path) as history:
            known = {int(sequence) for *_, run, sequence in history.readings() if run <= 2}
            result = replay(history)
    except sqlite3.DatabaseError as error:
        verdict.wrong.append(f"torn: {error}")
        return verdict
    if not result.identical:
        verdict.wrong.append(f"replay: {result.first}")
    missing = [number for number in handed if number not in known]
    if any(number < (told + 1) * _READINGS_A_STEP for number in missing):
        verdict.wrong.append(f"reading {min(missing)} is lost, and step {told} after it was reported as stored")
    if missing:
        verdict.lost_s = passed[-1].seconds - handed[min(missing)]
    return verdict


@click.command()
@click.option("--count", default=1000, show_default=True)
@click.option("--seed", default=0, show_default=True)
@click.option("--session", "folder", type=click.Path(path_type=Path), hidden=True)
def main(count: int, seed: int, folder: Path | None) -> None:
    """Cut the power COUNT times, start a gateway on each disk, and print what it found."""
    if folder is not None:
        session(folder)
        return
    with tempfile.TemporaryDirectory() as name:
        acts = recorded(Path(name))
        verdicts, wrong = [], list[str]()
        for i in range(seed, seed + count):
            with tempfile.TemporaryDirectory(dir=name) as here:
                verdicts.append(cut_and_start(acts, i, Path(here)))
            wrong += [f"seed {i}: {text}" for text in verdicts[-1].wrong]
    writes, syncs = (sum(act.what in kinds for act in acts) for kinds in ("wt", "s"))
    lost = sorted(v.lost_s for v in verdicts)
    click.echo(f"{writes} writes and {syncs} synchronisations recorded; commit_s = {COMMIT_S:g}")
    click.echo(
        f"power cuts: {count}; right after a write that was not synchronised: {sum(v.pending for v in verdicts)}"
    )
    click.echo(f"torn stores, lost steps, other decisions in a replay: {len(wrong)}")
    click.echo(f"readings lost: median {lost[len(lost) // 2]:.3f} s, at most {lost[-1]:.3f} s")
    if wrong:
        click.echo("\n".join(wrong))
        sys.exit(1)


if __name__ == "__main__":
    main()
