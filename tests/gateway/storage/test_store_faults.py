"""A disk that is full, fails or hangs, or a locked file: nothing ends, and no decision is lost."""

import sqlite3
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from drivers.base import Quality
from gateway.acquisition import Sample
from gateway.events import DecisionMade, FrameMade, ProbingRequested, ReadingsTaken
from gateway.storage import History, Store, StoreError
from gateway.storage.waiting import Item, Kind, Waiting
from tests.benches.failing_disk import store_process
from tests.benches.stepped_clock import EPOCH, SteppedClock
from tests.benches.store_writer import step

RETRY_S = 0.1


def stored(path: Path) -> list[int]:
    with History(path) as history:
        found = list(history.steps())
    for one in found:
        assert one.frame.inputs.tobytes() == step(one.frame.k)[0].inputs.tobytes()
    return [one.frame.k for one in found]


@pytest.mark.parametrize("fault", ["ENOSPC", "EIO", "EROFS"])
def test_what_a_failing_disk_refuses_waits_and_is_stored_when_it_works_again(fault: str, tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    with store_process(path) as store:
        store.ask("step 1")
        assert store.ask("flush") == ""
        store.ask(f"fault {fault}")
        store.ask("step 2")
        health = store.until(failing=True)
        assert health["faults"] > 0
        for k in range(3, 30):
            store.ask(f"step {k}")
        assert store.ask("flush"), "who must know that it is stored is told that it is not"
        health = store.ask("health")
        assert health["waiting"] >= 28 * 3
        assert health["failing_s"] > 0
        assert stored(path) == [1], "readable meanwhile"
        store.ask("fault ok")
        began = time.monotonic()
        store.until(failing=False)
        assert time.monotonic() - began < 60.0
        assert store.ask("close") == ""
    assert stored(path) == list(range(1, 30))


def test_a_disk_that_hangs_delays_no_writer(tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    with store_process(path) as store:
        store.ask("fault hangs")
        took_s = [store.ask(f"step {k}") for k in range(50)]
        assert max(took_s) < 1.0
        store.ask("fault ok")
        assert store.ask("close") == ""
    assert stored(path) == list(range(50))


def test_stopped_while_the_disk_is_full_it_says_how_much_is_lost(tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    with store_process(path) as store:
        store.ask("step 1")
        store.ask("flush")
        store.ask("fault ENOSPC")
        store.ask("step 2")
        said = store.ask("close")
    assert "g.sqlite: 4 rows were not stored: " in said
    assert stored(path) == [1]


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """By another program's connection."""
    with closing(sqlite3.connect(path, isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")
        yield
        other.execute("ROLLBACK")


def until(store: Store, failing: bool) -> None:
    end = time.monotonic() + 60.0
    while bool(store.health.problem) is not failing or (not failing and store.health.waiting):
        assert time.monotonic() < end, store.health
        time.sleep(0.01)


def make(store: Store, k: int) -> None:
    frame, decision = step(k)
    store.record(ReadingsTaken([Sample("a", 20.0, "degC", Quality.GOOD, EPOCH, 0.0, sequence=k)]))
    store.record(FrameMade(frame))
    store.record(DecisionMade(decision))


def test_what_another_program_locks_out_waits_and_is_stored_when_the_lock_is_gone(tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    with Store(path, "boot1", SteppedClock(), commit_s=0.01, retry_s=RETRY_S) as store:
        make(store, 1)
        store.flush()
        with locked(path):
            for k in range(2, 20):
                make(store, k)
            until(store, failing=True)
            assert "locked" in store.health.problem
            with pytest.raises(StoreError, match="locked"):
                store.record(ProbingRequested(7))
        until(store, failing=False)
        store.record(ProbingRequested(8))
    assert stored(path) == list(range(1, 20))
    with History(path) as history:
        assert history.last_number() == 8


def item(number: int, kind: Kind, rows: int = 1) -> Item:
    return Item(number, "", [(number,)] * rows, kind, commit=False)


def test_of_too_many_rows_the_oldest_readings_go_and_never_a_decision() -> None:
    waiting = Waiting()
    most = Kind.READINGS.value
    assert most is not None
    waiting.put(item(0, Kind.KEPT))
    for number in range(1, most // 30 + 11):
        waiting.put(item(number, Kind.READINGS, 30))
        waiting.put(item(number, Kind.KEPT))
    assert waiting.dropped[Kind.READINGS] == (most // 30 + 10) * 30 - most // 30 * 30
    assert waiting.dropped[Kind.KEPT] == 0
    taken = []
    while (one := waiting.take()) is not None:
        taken.append(one)
    assert [one.number for one in taken if one.kind is Kind.KEPT] == list(range(most // 30 + 11))
    assert [one.number for one in taken if one.kind is Kind.READINGS] == list(range(11, most // 30 + 11))


@pytest.mark.parametrize("kind", [Kind.READINGS, Kind.STEPS, Kind.EVENTS])
def test_what_is_put_back_is_bounded_too(kind: Kind) -> None:
    waiting = Waiting()
    most = kind.value
    assert most is not None
    taken = [item(number, kind) for number in range(10)]
    for number in range(10, most + 5):
        waiting.put(item(number, kind))
    waiting.put_back(taken)
    assert waiting.rows == most
    first = waiting.take()
    assert first is not None
    assert first.number == 5
