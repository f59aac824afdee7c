"""A disk that is full, fails or hangs, or a locked file: nothing ends, and no decision is lost."""

import asyncio
import sqlite3
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from drivers.base import Quality
from gateway.model.events import DecisionMade, FrameMade, ProbingRequested, ReadingsTaken
from gateway.model.sample import Sample
from gateway.model.text import NOTHING
from gateway.storage.faults import StoreError
from gateway.storage.history import History
from gateway.storage.schema import make_schema
from gateway.storage.store import Store
from gateway.storage.timing import WriterTiming
from gateway.storage.waiting import Item, Waiting, WaitingKind
from gateway.storage.writer import DatabaseWriter
from tests.benches.failing_disk import store_process
from tests.benches.stepped_clock import EPOCH, SteppedClock
from tests.benches.store_waits import until_all_written, until_failing
from tests.benches.store_writer import step
from tests.benches.waits import until, wait_until

RETRY_S = 0.1
LIMIT_S = 60.0


def stored(path: Path) -> list[int]:
    with History(path) as history:
        found = list(history.steps())
    for one in found:
        assert one.frame.inputs.tobytes() == step(one.frame.k)[0].inputs.tobytes()
    return [one.frame.k for one in found]


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["ENOSPC", pytest.param("EIO", marks=pytest.mark.slow)])
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
        assert store.ask("flush"), "a caller that must know whether it is stored learns that it is not"
        health = store.ask("health")
        assert health["waiting"] >= 28 * 3
        assert health["failing_s"] > 0
        assert stored(path) == [1], "readable meanwhile"
        store.ask("fault ok")
        store.until(failing=False)
        assert store.ask("close") == ""
    assert stored(path) == list(range(1, 30))


@pytest.mark.slow
def test_what_was_written_but_not_synchronised_is_not_stored_twice(tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    with store_process(path) as store:
        store.ask("step 1")
        assert store.ask("flush") == ""
        store.ask("fault EIO synchronise")
        store.ask("step 2")
        assert store.until(failing=True)["faults"] > 0
        store.ask("fault ok")
        store.until(failing=False)
        store.ask("step 3")
        assert store.ask("close") == ""
    assert stored(path) == [1, 2, 3]


@pytest.mark.slow
def test_a_disk_that_hangs_delays_no_writer_and_counts_as_failing_until_it_answers(tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    with store_process(path, hangs_after_s=0.2) as store:
        store.ask("fault hangs")
        took_s = [store.ask(f"step {k}") for k in range(50)]
        assert max(took_s) < 60.0, "the disk hangs until the test releases it"
        health = store.until(failing=True)
        assert health["problem"] == "the disk does not answer"
        assert health["failing_s"] >= 0.2
        store.ask("fault ok")
        store.until(failing=False)
        assert store.ask("close") == ""
    assert stored(path) == list(range(50))


@pytest.mark.slow
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


@pytest.mark.slow
@pytest.mark.parametrize("calls", ["", " synchronise"], ids=["every call hangs", "synchronising hangs"])
def test_stopped_while_the_disk_hangs_it_ends_and_says_what_may_be_lost(calls: str, tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    with store_process(path, silent_s=0.5) as store:
        store.ask("step 1")
        store.ask("flush")
        store.ask(f"fault hangs{calls}")
        store.ask("step 2")
        said = store.ask("close")
        assert store.ended() == 0, "the thread that hangs does not keep the process"
    assert "the disk does not answer" in said
    assert "4 rows may be lost" in said
    for table in ("reading 1", "frame 1", "trust 1", "decision 1"):
        assert table in said
    assert stored(path) in ([1], [1, 2]), "whole steps"


def test_stopped_while_an_old_record_is_deleted_it_stores_the_rest_and_deletes_later(tmp_path: Path) -> None:
    begun = threading.Event()
    path = tmp_path / "g.sqlite"
    make_schema(path)

    def endless(connection: sqlite3.Connection) -> None:
        begun.set()
        connection.execute("INSERT INTO event (time, kind, text) VALUES ('', '', 'in the transaction')")
        connection.execute("WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT max(i) FROM n")

    writer = DatabaseWriter(path, WriterTiming(commit_s=10.0, silent_s=0.2), endless, lambda _: None, lambda _: NOTHING)
    writer.put("event", "INSERT INTO event (time, kind, text) VALUES ('', '', ?)", [("waited",)])
    writer.start()
    assert begun.wait(LIMIT_S)
    assert writer.close()
    writer.check()
    with closing(sqlite3.connect(path)) as connection:
        assert connection.execute("SELECT text FROM event").fetchall() == [("waited",)]


def test_a_disk_that_refuses_to_delete_old_rows_counts_as_failing_until_it_does(tmp_path: Path) -> None:
    told: list[str] = []
    often = threading.Event()
    path = tmp_path / "g.sqlite"
    make_schema(path)

    def refused(_: sqlite3.Connection) -> None:
        told.append(writer.health.problem)
        if len(told) == 4:
            often.set()
        error = sqlite3.OperationalError("disk I/O error")
        error.sqlite_errorcode = sqlite3.SQLITE_IOERR
        raise error

    writer = DatabaseWriter(path, WriterTiming(commit_s=10.0, retry_s=0.01), refused, lambda _: None, lambda _: NOTHING)
    writer.start()
    assert often.wait(LIMIT_S)
    assert writer.close()
    assert told[:4] == ["", *["disk I/O error"] * 3], "an attempt with nothing to write ends no problem"


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Inside, another program's connection locks the file."""
    with closing(sqlite3.connect(path, isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")
        yield
        other.execute("ROLLBACK")


def make(store: Store, k: int) -> None:
    frame, decision = step(k)
    store.record(ReadingsTaken([Sample("a", 20.0, "degC", Quality.GOOD, EPOCH, 0.0, sequence=k)]))
    store.record(FrameMade(frame))
    store.record(DecisionMade(decision))


def has_readings(connection: sqlite3.Connection, count: int) -> bool:
    return bool(connection.execute("SELECT count(*) FROM reading").fetchone() == (count,))


def test_readings_reach_the_file_without_anything_that_hurries_them(tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    with Store(path, "boot1", SteppedClock(), commit_s=0.3) as store, closing(sqlite3.connect(path)) as other:
        store.flush()
        for k in range(1, 4):  # one after the other is in the file
            store.record(ReadingsTaken([Sample("a", 20.0, "degC", Quality.GOOD, EPOCH, 0.0, sequence=k)]))
            if k == 1:
                store.flush()  # the channel's name
            wait_until(partial(has_readings, other, k))


async def test_what_another_program_locks_out_waits_and_is_stored_when_the_lock_is_gone(tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    with Store(path, "boot1", SteppedClock(), commit_s=0.01, retry_s=RETRY_S) as store:
        make(store, 1)
        store.flush()
        with locked(path):
            for k in range(2, 20):
                make(store, k)
            until_failing(store)
            assert "locked" in store.health.problem
            store.record(ProbingRequested(7))
            with pytest.raises(StoreError, match="locked"):
                await store.on_disk()
        until_all_written(store)
        store.record(ProbingRequested(8))
        await store.on_disk(LIMIT_S)
        with History(path) as history:
            assert history.last_number() == 8
    assert stored(path) == list(range(1, 20))


@pytest.mark.slow
@pytest.mark.waits(12)
def test_with_the_shipped_intervals_it_writes_again_soon_after_the_cause_is_gone(tmp_path: Path) -> None:
    """5 s for the lock, and 5 s until the next attempt. The promise is 60 s."""
    path = tmp_path / "g.sqlite"
    with Store(path, "boot1", SteppedClock()) as store:
        make(store, 1)
        store.flush()
        with locked(path):
            make(store, 2)
            until_failing(store)
        began = time.monotonic()
        until_all_written(store)
        assert time.monotonic() - began < 60.0
    assert stored(path) == [1, 2]


def test_the_first_rows_that_are_stored_again_end_the_problem(tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    with Store(path, "boot1", SteppedClock(), commit_s=10 * LIMIT_S, retry_s=RETRY_S) as store:
        make(store, 1)
        store.flush()
        with locked(path):
            make(store, 2)
            store.record(ProbingRequested(7))
            until_failing(store)
        until_all_written(store)
        store.flush()
    assert stored(path) == [1, 2]


async def test_the_event_loop_runs_while_a_number_waits_for_another_programs_lock(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, writes = tmp_path / "g.sqlite", threading.Event()

    class Told(sqlite3.Connection):
        def executemany(self, statement: str, rows: Any, /) -> sqlite3.Cursor:
            writes.set()
            return super().executemany(statement, rows)

    monkeypatch.setattr(sqlite3, "connect", partial(sqlite3.connect, factory=Told))
    with Store(path, "boot1", SteppedClock(), retry_s=LIMIT_S) as store:
        make(store, 1)
        store.flush()
        with locked(path):
            writes.clear()
            store.record(ProbingRequested(7))
            waiting = asyncio.ensure_future(store.on_disk(LIMIT_S))
            await asyncio.sleep(0)  # now it begins
            await until(writes.is_set)
            assert not waiting.done()
            assert store.health.problem == "", "it waits for the lock"
        await waiting
        with History(path) as history:
            assert history.last_number() == 7


def item(number: int, kind: WaitingKind, rows: int = 1) -> Item:
    return Item(number, "", "", [(number,)] * rows, kind, commit=False)


def test_of_too_many_rows_the_oldest_readings_go_and_never_a_decision() -> None:
    waiting = Waiting()
    most = WaitingKind.READINGS.value
    assert most is not None
    waiting.put(item(0, WaitingKind.KEPT))
    for number in range(1, most // 30 + 11):
        waiting.put(item(number, WaitingKind.READINGS, 30))
        waiting.put(item(number, WaitingKind.KEPT))
    assert waiting.dropped[WaitingKind.READINGS] == (most // 30 + 10) * 30 - most // 30 * 30
    assert waiting.dropped[WaitingKind.KEPT] == 0
    taken = []
    while (one := waiting.take()) is not None:
        taken.append(one)
    assert [one.number for one in taken if one.kind is WaitingKind.KEPT] == list(range(most // 30 + 11))
    assert [one.number for one in taken if one.kind is WaitingKind.READINGS] == list(range(11, most // 30 + 11))


@pytest.mark.parametrize("kind", [WaitingKind.READINGS, WaitingKind.STEPS, WaitingKind.EVENTS])
def test_what_is_put_back_is_bounded_too(kind: WaitingKind) -> None:
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
