"""Databases with spoilt pages and bits, and a gateway that starts on them.

`python -m tests.benches.spoilt_stores --count 1000` prints a table of what became of each.
"""

import random
import sqlite3
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from contextlib import closing
from datetime import timedelta
from pathlib import Path

import click
import numpy as np

from drivers.base import Quality
from gateway.control.restart.earlier import EarlierRun, earlier_run
from gateway.model.events import DecisionMade, EventReported, FrameMade, MeasurementEnded, ReadingsTaken, Sink
from gateway.model.probing import Outcome
from gateway.model.sample import Sample
from gateway.storage.faults import StoreError
from gateway.storage.history import History
from gateway.storage.store import Store
from talc.control import Controller
from talc.frame import Event, EventKind, Frame, Measurement, Why
from tests.benches.service_file import two_temperatures
from tests.benches.stepped_clock import EPOCH, SteppedClock

Damage = Callable[[bytearray, int, random.Random], None]

STEPS = 150
PAGE = 4096


def frame(k: int) -> Frame:
    draw = np.random.default_rng(k)
    measurement = Measurement(draw.normal(0, 5.0, 9), np.full(9, 0.5)) if k % 5 == 0 else None
    return Frame(k, 20.0 + draw.normal(0, 1.0, 2), np.ones(2, np.bool_), measurement)


def reading(number: int) -> ReadingsTaken:
    """One reading, with this number of the read."""
    return ReadingsTaken([Sample("bed", 20.0 + number, "degC", Quality.GOOD, EPOCH, 0.0, sequence=number)])


def write(store: Store, controller: Controller, k: int, also: Sink = lambda _: None) -> None:
    """Step k of a gateway, with all that is stored of it.

    also: gets the step's events too
    """
    one = frame(k)
    if one.measurement is not None:
        centres = np.random.default_rng(k).normal(0, 100.0, (6, 3))
        later = EPOCH + timedelta(seconds=300 * k)
        store.record(
            MeasurementEnded(Outcome(k + 1, Why.INTERVAL, EPOCH, later, centres, (0.0, 0.0, 0.0), one.measurement, 0.4))
        )
    store.record(reading(k))
    store.record(EventReported(Event(EventKind.PROBLEM, f"event {k} " + "x" * 200), k))
    for event in (FrameMade(one), DecisionMade(controller.step(one))):
        store.record(event)
        also(event)


def make_whole(path: Path) -> None:
    """A database of an earlier run, closed."""
    settings = two_temperatures(path)
    with Store(path, "earlier", SteppedClock()) as store:
        store.begin(settings.canonical(), settings.fingerprint(), "")
        controller = earlier_run(store, settings).controller
        for k in range(STEPS):
            write(store, controller, k)


def pages_of(path: Path, table: str) -> list[int]:
    """Byte offsets of the pages that contain the rows of a table."""
    with closing(sqlite3.connect(path)) as connection:
        found = connection.execute("SELECT pageno FROM dbstat WHERE name = ? AND pagetype = 'leaf'", (table,))
        return [(number - 1) * PAGE for (number,) in found]


def zero(data: bytearray, at: int, _: random.Random) -> None:
    data[at : at + PAGE] = bytes(PAGE)


def noise(data: bytearray, at: int, draw: random.Random) -> None:
    data[at : at + PAGE] = draw.randbytes(PAGE)


def one_bit(data: bytearray, at: int, draw: random.Random) -> None:
    data[at + draw.randrange(PAGE)] ^= 1 << draw.randrange(8)


def bits(data: bytearray, at: int, draw: random.Random) -> None:
    for _ in range(draw.randint(1, 40)):
        data[at + draw.randrange(PAGE)] ^= 1 << draw.randrange(8)


def elsewhere(data: bytearray, at: int, draw: random.Random) -> None:
    other = draw.randrange(len(data) // PAGE) * PAGE
    data[at : at + PAGE] = data[other : other + PAGE]


def cut(data: bytearray, at: int, _: random.Random) -> None:
    del data[max(at, PAGE) :]


DAMAGES: list[Damage] = [zero, noise, one_bit, bits, elsewhere, cut]


def damaged(whole: Path, to: Path, damage: Damage, seed: int) -> None:
    draw = random.Random(seed)
    data = bytearray(whole.read_bytes())
    if not seed % 2:  # of a page that is sure to be read; where the others lie depends on the writer's pace
        damage(data, draw.choice(pages_of(whole, "frame")), draw)
    for _ in range(draw.choice((1, 1, 3))):
        if len(data) > 2 * PAGE:
            damage(data, draw.randrange(len(data) // PAGE) * PAGE, draw)
    to.write_bytes(data)


def restarted(path: Path, boot: str) -> tuple[EarlierRun, str]:
    """A run of ten steps; returns its past, and what it reported about damage."""
    settings = two_temperatures(path)
    with Store(path, boot, SteppedClock(), commit_s=0.01, retry_s=0.05) as store:
        past = earlier_run(store, settings)
        store.begin(settings.canonical(), settings.fingerprint(), "")
        first = 0 if past.last_k is None else past.last_k + 1
        for k in range(first, first + 10):
            write(store, past.controller, k)
        settle(store)
        return past, store.health.mended


def settle(store: Store) -> None:
    """Wait until everything is stored, whatever had to be mended."""
    end = time.monotonic() + 60.0
    while True:
        try:
            store.flush()
            return
        except StoreError:
            assert time.monotonic() < end, store.health
            time.sleep(0.05)  # the writer needs the lock that each try takes


def check_start(path: Path) -> bool:
    """Start twice; whether damage was found."""
    aside_before = set(path.parent.iterdir())
    past, mended = restarted(path, "second")
    aside = [p.name for p in set(path.parent.iterdir()) - aside_before if ".damaged-" in p.name]
    assert bool(mended) is bool(aside)
    assert any(name in mended for name in aside) or not aside
    with History(path) as history:
        steps = list(history.steps())
        history.events()
    assert steps[-1].frame.k == (-1 if past.last_k is None else past.last_k) + 10, "learning went on"
    again, mended_again = restarted(path, "third")
    assert not mended_again
    assert again.last_k == steps[-1].frame.k
    return bool(mended)


@click.command()
@click.option("--count", default=1000, show_default=True)
@click.option("--seed", default=0, show_default=True)
def main(count: int, seed: int) -> None:
    """Spoil COUNT databases, start a gateway on each, twice, and print what became of them."""
    found, failed = Counter[tuple[str, bool]](), list[str]()
    with tempfile.TemporaryDirectory() as folder:
        whole = Path(folder) / "whole" / "g.sqlite"
        whole.parent.mkdir()
        make_whole(whole)
        for i in range(seed, seed + count):
            damage = DAMAGES[i % len(DAMAGES)]
            with tempfile.TemporaryDirectory(dir=folder) as here:
                path = Path(here) / "g.sqlite"
                damaged(whole, path, damage, i)
                try:
                    found[damage.__name__, check_start(path)] += 1
                except Exception as error:  # noqa: BLE001 - whatever it is, it is the result
                    failed.append(f"{damage.__name__}, seed {i}: {error!r}")
    click.echo(f"{'damage':<12}{'databases':>12}{'found, told and repaired':>28}{'nothing noticed':>18}")
    for damage in DAMAGES:
        told, quiet = found[damage.__name__, True], found[damage.__name__, False]
        click.echo(f"{damage.__name__:<12}{told + quiet:>12}{told:>28}{quiet:>18}")
    click.echo("\n".join(failed) or "each gateway started, learnt on and started again")


if __name__ == "__main__":
    main()
