"""The database is deleted while the gateway runs: this is noticed and reported, and another one is begun."""

import multiprocessing
import os
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from gateway.model.codes import NoticeCode
from gateway.model.events import DecisionMade, FrameMade, MeasurementEnded, ReadingsTaken
from gateway.storage.damage import damage_found
from gateway.storage.faults import StoreError
from gateway.storage.history import History
from gateway.storage.place import PlaceWatch
from gateway.storage.schema import connect
from gateway.storage.store import Store
from tests.benches import telemetry_examples as example
from tests.benches.stepped_clock import SteppedClock
from tests.benches.store_waits import until_all_written
from tests.benches.store_writer import step
from tests.benches.waits import wait_until


def store_at(path: Path) -> Store:
    return Store(path, "boot1", SteppedClock(), commit_s=0.01, retry_s=0.05, look_s=0.02)


def make(store: Store, k: int) -> None:
    frame, decision = step(k)
    store.record(ReadingsTaken([example.READING]))
    store.record(FrameMade(frame))
    store.record(DecisionMade(decision))


def delete_all(path: Path) -> None:
    for one in path.parent.iterdir():
        one.unlink(missing_ok=True)  # SQLite removes its own files


def delete_the_file(path: Path) -> None:
    path.unlink()


def delete_the_folder(path: Path) -> None:
    delete_all(path)
    path.parent.rmdir()


@pytest.mark.parametrize("delete", [delete_all, delete_the_file, delete_the_folder])
def test_another_database_is_begun_and_says_so(delete: Callable[[Path], None], tmp_path: Path) -> None:
    path = tmp_path / "data" / "g.sqlite"
    with store_at(path) as store:
        store.begin("{}", "hash", "versions")
        store.record(MeasurementEnded(example.OUTCOME))
        make(store, 1)
        store.flush()
        delete(path)
        wait_until(lambda: store.health.mended)
        assert "was deleted while the gateway ran; a new database is begun" in store.health.mended
        make(store, 2)
        until_all_written(store)
    with History(path) as history:
        assert [found.frame.k for found in history.steps()] == [2]
        assert history.config() == ("{}", "hash", "versions")
        assert [m.number for m in history.measurements()] == [example.OUTCOME.number], "the reference of all others"
        assert list(history.channel_health()) == [example.READING.channel]
    assert [p.name for p in path.parent.iterdir()] == ["g.sqlite"]


def test_another_file_in_its_place_is_set_aside(tmp_path: Path) -> None:
    path, other = tmp_path / "g.sqlite", tmp_path / "other.sqlite"
    with store_at(other) as store:
        make(store, 5)
    with store_at(path) as store:
        store.begin("{}", "hash", "versions")
        make(store, 7)
        store.flush()
        other.replace(path)
        wait_until(lambda: store.health.mended)
        assert "another file was put in its place" in store.health.mended
    assert len(list(tmp_path.glob("g.sqlite.damaged-*"))) == 1


def _refused(path: Path, answers: "multiprocessing.Queue[str]") -> None:
    try:
        with store_at(path):
            answers.put("")
    except StoreError as error:
        answers.put(str(error))


@pytest.mark.slow
def test_deleting_everything_that_is_there_does_not_delete_the_lock(tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    with store_at(path) as store:
        make(store, 1)
        store.flush()
        delete_all(path)
        context = multiprocessing.get_context("spawn")
        answers: multiprocessing.Queue[str] = context.Queue()
        other = context.Process(target=_refused, args=(path, answers))
        other.start()
        said = answers.get(timeout=60)
        other.join()
    assert "another gateway writes to it" in said


@pytest.mark.parametrize("left", [0, 50, 4096, 5 * 4096 + 7])
def test_a_file_that_is_cut_in_place_is_set_aside(left: int, tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    with store_at(path) as store:
        make(store, 0)
    with store_at(path) as store:
        store.begin("{}", "hash", "versions")
        store.record(MeasurementEnded(example.OUTCOME))
        make(store, 1)
        store.flush()
        os.truncate(path, left)
        wait_until(lambda: store.health.mended)
        assert f"it was cut to {left} bytes while the gateway ran" in store.health.mended
        make(store, 2)
        until_all_written(store)
    with History(path) as history:
        assert 2 in [found.frame.k for found in history.steps()]
        assert history.config() == ("{}", "hash", "versions")
        assert [m.number for m in history.measurements()] == [example.OUTCOME.number], "the reference of all others"
    assert not damage_found(path)
    assert len(list(tmp_path.glob("g.sqlite.damaged-*"))) >= 1


@pytest.mark.parametrize("left", [0, 32 + 24 + 4096, None])
def test_a_log_that_is_cut_in_place_is_noticed(left: int | None, tmp_path: Path) -> None:
    """None: cut to nothing, and written to behind a hole before anybody looked."""
    path = tmp_path / "g.sqlite"
    with store_at(path) as store:
        make(store, 0)
    with store_at(path) as store:
        store.begin("{}", "hash", "versions")
        store.record(MeasurementEnded(example.OUTCOME))
        for k in range(1, 20):
            make(store, k)
            store.flush()
        log = path.with_name("g.sqlite-wal")
        size = log.stat().st_size
        os.truncate(log, left or 0)
        if left is None:
            os.truncate(log, size + 4120)
        wait_until(lambda: store.health.mended)
        assert "its log (-wal) was cut to " in store.health.mended
        make(store, 20)
        until_all_written(store)
    with History(path) as history:
        assert 20 in [found.frame.k for found in history.steps()]
        assert history.config() == ("{}", "hash", "versions")
        assert [m.number for m in history.measurements()] == [example.OUTCOME.number], "the reference of all others"
    assert not damage_found(path)
    assert len(list(tmp_path.glob("g.sqlite.damaged-*"))) >= 1


@pytest.mark.parametrize("left", [-1, 0, 32 + 24 + 4096, None])
def test_a_log_that_was_cut_after_a_kill_is_noticed_by_the_next_start(left: int | None, tmp_path: Path) -> None:
    """None: it is whole; -1: nothing of it is left, nor its index."""
    path, killed = tmp_path / "g.sqlite", tmp_path / "killed" / "g.sqlite"
    with store_at(path) as store:
        store.begin("{}", "hash", "versions")
        store.record(MeasurementEnded(example.OUTCOME))
        make(store, 0)
    with store_at(path) as store:
        store.begin("{}", "hash", "versions")
        for k in range(1, 20):
            make(store, k)
        store.flush()
        killed.parent.mkdir()
        for ending in ("", "-wal", "-shm"):
            shutil.copy(f"{path}{ending}", f"{killed}{ending}")
    if left is not None:
        os.truncate(f"{killed}-wal", max(left, 0))
        if left < 0:
            Path(f"{killed}-shm").unlink()
    with store_at(killed) as store:
        store.begin("{}", "hash", "versions")
        told = store.health.mended
        assert told == "" if left is None else told.says(NoticeCode.DATABASE_LOG_LEFT_CUT), told
        make(store, 20)
        store.flush()
    with History(killed) as history:
        assert [found.frame.k for found in history.steps()] == [*range(1 if left is not None else 20), 20]
    assert not damage_found(killed)


def test_a_log_that_another_program_empties_in_order_stays(tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    with store_at(path) as store:
        store.begin("{}", "hash", "versions")
        for k in range(50):
            make(store, k)
            with closing(sqlite3.connect(path, timeout=60.0)) as tool:
                tool.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        until_all_written(store)
        assert not store.health.mended
    with History(path) as history:
        assert [found.frame.k for found in history.steps()] == list(range(50))


def test_a_file_that_another_program_makes_smaller_in_order_stays(tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    with store_at(path) as store:
        store.begin("{}", "hash", "versions")
        for k in range(100):
            make(store, k)
        store.flush()
        with closing(sqlite3.connect(path, timeout=60.0)) as tool:
            tool.execute("DELETE FROM event")
            tool.execute("DELETE FROM decision WHERE k < 90")
            tool.execute("DELETE FROM frame WHERE k < 90")
            tool.commit()
            tool.execute("PRAGMA wal_checkpoint(TRUNCATE)")
            before = path.stat().st_size
            tool.execute("VACUUM")
            tool.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        assert path.stat().st_size < before
        for k in range(100, 120):
            make(store, k)
            store.flush()  # the thread looks before each commit
        assert not store.health.mended
    with History(path) as history:
        assert [found.frame.k for found in history.steps()] == list(range(90, 120))


def test_a_reader_that_keeps_a_checkpoint_from_the_last_page_is_not_a_cut(tmp_path: Path) -> None:
    """The header then counts a page that is only in the log, and the file is shorter."""
    path = tmp_path / "g.sqlite"
    with closing(connect(path)) as writer, closing(sqlite3.connect(path)) as reader:
        writer.execute("CREATE TABLE t (x)")
        writer.commit()
        writer.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        place = PlaceWatch(path)
        writer.executemany("INSERT INTO t VALUES (?)", [("x" * 3000,)] * 5)
        writer.commit()
        reader.execute("BEGIN")
        reader.execute("SELECT count(*) FROM t").fetchone()
        writer.execute("UPDATE t SET x = 'y' WHERE rowid = 5")
        writer.commit()
        writer.execute("PRAGMA wal_checkpoint(PASSIVE)")
        data = path.read_bytes()
        assert len(data) < 4096 * int.from_bytes(data[28:32], "big")
        place.look()
