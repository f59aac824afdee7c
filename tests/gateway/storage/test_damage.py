"""A damaged database: set aside with its name reported, what can be read is kept, and the gateway starts."""

import random
import shutil
import sqlite3
import time
from collections.abc import Callable
from contextlib import closing
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest

from drivers.base import Quality
from gateway.acquisition import Sample
from gateway.events import DecisionMade, EventReported, FrameMade, MeasurementEnded, ReadingsTaken
from gateway.past import Past, past_in
from gateway.probing import Outcome
from gateway.storage import History, Store, StoreError
from talc.control import Controller
from talc.frame import Event, EventKind, Frame, Measurement, Why
from tests.benches.service_file import two_temperatures
from tests.benches.stepped_clock import EPOCH, SteppedClock

STEPS = 150
PAGE = 4096


def frame(k: int) -> Frame:
    draw = np.random.default_rng(k)
    measurement = Measurement(draw.normal(0, 5.0, 9), np.full(9, 0.5)) if k % 5 == 0 else None
    return Frame(k, 20.0 + draw.normal(0, 1.0, 2), np.ones(2, np.bool_), measurement)


def write(store: Store, controller: Controller, k: int) -> None:
    one = frame(k)
    if one.measurement is not None:
        centres = np.random.default_rng(k).normal(0, 100.0, (6, 3))
        later = EPOCH + timedelta(seconds=300 * k)
        store.record(
            MeasurementEnded(Outcome(k + 1, Why.INTERVAL, EPOCH, later, centres, (0.0, 0.0, 0.0), one.measurement, 0.4))
        )
    store.record(ReadingsTaken([Sample("bed", 20.0 + k, "degC", Quality.GOOD, EPOCH, 0.0, sequence=k)]))
    store.record(EventReported(Event(EventKind.PROBLEM, f"event {k} " + "x" * 200), k))
    store.record(FrameMade(one))
    store.record(DecisionMade(controller.step(one)))


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A database of an earlier run, closed."""
    path = tmp_path_factory.mktemp("whole") / "g.sqlite"
    settings = two_temperatures(path)
    with Store(path, "earlier", SteppedClock()) as store:
        store.begin(settings.canonical(), settings.fingerprint(), "")
        controller = past_in(store, settings).controller
        for k in range(STEPS):
            write(store, controller, k)
    return path


def zero(data: bytearray, at: int, _: random.Random) -> None:
    data[at : at + PAGE] = bytes(PAGE)


def noise(data: bytearray, at: int, draw: random.Random) -> None:
    data[at : at + PAGE] = draw.randbytes(PAGE)


def bits(data: bytearray, at: int, draw: random.Random) -> None:
    for _ in range(draw.randint(1, 40)):
        data[at + draw.randrange(PAGE)] ^= 1 << draw.randrange(8)


def elsewhere(data: bytearray, at: int, draw: random.Random) -> None:
    other = draw.randrange(len(data) // PAGE) * PAGE
    data[at : at + PAGE] = data[other : other + PAGE]


def cut(data: bytearray, at: int, _: random.Random) -> None:
    del data[max(at, PAGE) :]


DAMAGES: list[Callable[[bytearray, int, random.Random], None]] = [zero, noise, bits, elsewhere, cut]


def damaged(whole: Path, to: Path, damage: Callable[[bytearray, int, random.Random], None], seed: int) -> None:
    draw = random.Random(seed)
    data = bytearray(whole.read_bytes())
    if not seed % 2:  # of a page that is sure to be read; where the others lie depends on the writer's pace
        damage(data, draw.choice(pages_of(whole, "frame")), draw)
    for _ in range(draw.choice((1, 1, 3))):
        if len(data) > 2 * PAGE:
            damage(data, draw.randrange(len(data) // PAGE) * PAGE, draw)
    to.write_bytes(data)


def restarted(path: Path, boot: str) -> tuple[Past, str]:
    """A run of ten steps; its past, and what was reported of damage."""
    settings = two_temperatures(path)
    with Store(path, boot, SteppedClock(), commit_s=0.01, retry_s=0.05) as store:
        past = past_in(store, settings)
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


@pytest.mark.slow
@pytest.mark.parametrize("damage", DAMAGES, ids=lambda damage: damage.__name__)
@pytest.mark.parametrize("seeds", [range(4), pytest.param(range(100, 120), marks=pytest.mark.slow)], ids=str)
def test_whatever_page_is_damaged_the_gateway_starts_and_goes_on(
    seeds: range, damage: Callable[[bytearray, int, random.Random], None], whole: Path, tmp_path: Path
) -> None:
    found = 0
    for seed in seeds:
        path = tmp_path / str(seed) / "g.sqlite"
        path.parent.mkdir()
        damaged(whole, path, damage, seed)
        found += check_start(path)
    assert found >= 1 or damage is bits, "a bit of a number may flip unnoticed"


def pages_of(path: Path, table: str) -> list[int]:
    """Byte offsets of the pages that hold the rows of a table."""
    with closing(sqlite3.connect(path)) as connection:
        found = connection.execute("SELECT pageno FROM dbstat WHERE name = ? AND pagetype = 'leaf'", (table,))
        return [(number - 1) * PAGE for (number,) in found]


def test_a_lost_page_of_frames_costs_those_frames_and_learning_goes_on_from_the_others(
    whole: Path, tmp_path: Path
) -> None:
    path = tmp_path / "g.sqlite"
    shutil.copy(whole, path)
    data = bytearray(whole.read_bytes())
    at = bytes(frame(70).inputs.astype("<f8").tobytes())
    page = data.index(at) // PAGE * PAGE
    data[page : page + PAGE] = bytes(PAGE)
    path.write_bytes(data)
    past, mended = restarted(path, "second")
    assert "g.sqlite was damaged" in mended
    assert past.last_k == STEPS - 1
    assert past.reference_mm is not None
    with History(path) as history:
        kept = {step.frame.k: step.frame for step in history.steps()}
    assert 70 not in kept
    assert len(kept) > STEPS // 2
    for k, one in kept.items():
        assert one.inputs.tobytes() == frame(k).inputs.tobytes()
    assert len(list(tmp_path.glob("g.sqlite.damaged-*"))) == 1


def test_without_the_reference_of_the_measurements_learning_begins_again(whole: Path, tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    data = bytearray(whole.read_bytes())
    page = data.index(np.random.default_rng(0).normal(0, 100.0, (6, 3)).astype("<f8").tobytes()) // PAGE * PAGE
    data[page : page + PAGE] = bytes(PAGE)
    path.write_bytes(data)
    past, mended = restarted(path, "second")
    assert past.last_k is None
    assert past.reference_mm is None
    assert "learning begins again" in mended


@pytest.mark.parametrize(
    "change",
    [
        "UPDATE reading SET id = 9223372036854775807 WHERE id = (SELECT max(id) FROM reading)",
        "UPDATE mark SET ran_s = 'noon'",
        "UPDATE measurement SET ended = '2026-p3-02T06:00:00+00:00' WHERE id = 1",
    ],
    ids=["number of a run", "text instead of a time", "time of the reference"],
)
def test_a_value_that_no_gateway_writes_is_damage_and_the_gateway_starts(
    whole: Path, tmp_path: Path, change: str
) -> None:
    path = tmp_path / "g.sqlite"
    shutil.copy(whole, path)
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute(change)
    assert check_start(path)


def test_damage_that_shows_while_it_runs_is_repaired_while_it_runs(whole: Path, tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    shutil.copy(whole, path)
    settings = two_temperatures(path)
    with Store(path, "second", SteppedClock(), commit_s=0.01, retry_s=0.05) as store:
        past = past_in(store, settings)
        store.begin(settings.canonical(), settings.fingerprint(), "")
        write(store, past.controller, STEPS)
        store.flush()
        with closing(sqlite3.connect(path)) as connection:
            connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
            (root,) = connection.execute("SELECT rootpage FROM sqlite_master WHERE name = 'decision'").fetchone()
        with path.open("r+b") as file:
            file.seek((root - 1) * PAGE)
            file.write(bytes(PAGE))
        for k in range(STEPS + 1, STEPS + 20):
            write(store, past.controller, k)
        settle(store)
        assert "g.sqlite was damaged" in store.health.mended
    again, mended = restarted(path, "third")
    assert not mended
    assert again.last_k == STEPS + 19
    assert again.reference_mm is not None


def test_a_whole_database_is_never_set_aside(whole: Path, tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    shutil.copy(whole, path)
    with Store(path, "second", SteppedClock()) as store, pytest.raises(ZeroDivisionError):
        store.repair(ZeroDivisionError("a mistake in the program"), 0)
    assert not list(tmp_path.glob("*damaged*"))
