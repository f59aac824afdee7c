"""A damaged database is set aside and its name reported, what can be read is kept, and the gateway starts."""

import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from gateway.control.restart.earlier import earlier_run
from gateway.control.restart.rebuild import marks
from gateway.model.events import DecisionMade, FrameMade
from gateway.model.step_time import StepTime
from gateway.storage.damage import damage_found
from gateway.storage.history import History
from gateway.storage.leaf_pages import rows_cut_off
from gateway.storage.outside import generations
from gateway.storage.schema import shown_as
from gateway.storage.snapshot import Snapshot
from gateway.storage.store import Store
from tests.benches.service_file import two_temperatures
from tests.benches.spoilt_stores import (
    DAMAGES,
    PAGE,
    STEPS,
    Damage,
    bits,
    check_start,
    damaged,
    frame,
    make_whole,
    one_bit,
    pages_of,
    restarted,
    settle,
    write,
)
from tests.benches.stepped_clock import SteppedClock
from tests.benches.store_writer import step


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A database of an earlier run, closed."""
    path = tmp_path_factory.mktemp("whole") / "g.sqlite"
    make_whole(path)
    return path


@pytest.mark.slow
@pytest.mark.parametrize("damage", DAMAGES, ids=lambda damage: damage.__name__)
def test_whatever_page_is_damaged_the_gateway_starts_and_goes_on(damage: Damage, whole: Path, tmp_path: Path) -> None:
    found = 0
    for seed in range(4):
        path = tmp_path / str(seed) / "g.sqlite"
        path.parent.mkdir()
        damaged(whole, path, damage, seed)
        found += check_start(path)
    assert found >= 1 or damage in (one_bit, bits), "a bit of a number may flip unnoticed"


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


def intact_steps(whole: Path, data: bytes) -> set[int]:
    """The steps whose frame and decision stand on pages that are as they were."""
    found: dict[str, set[int]] = {"frame": set(), "decision": set()}
    as_it_was = whole.read_bytes()
    with closing(sqlite3.connect(whole)) as connection:
        for table, steps in found.items():
            pages = "SELECT pageno, ncell FROM dbstat WHERE name = ? AND pagetype = 'leaf' ORDER BY path"
            numbers = [k for (k,) in connection.execute(f"SELECT k FROM {table} ORDER BY k")]
            for page, cells in connection.execute(pages, (table,)):
                of_page, numbers = numbers[:cells], numbers[cells:]
                at = slice((page - 1) * PAGE, page * PAGE)
                if data[at] == as_it_was[at]:
                    steps.update(of_page)
    return found["frame"] & found["decision"]


@pytest.mark.parametrize("left", [-PAGE, -100, 0.93])
def test_of_a_database_that_is_cut_off_anywhere_every_row_on_a_whole_page_is_kept(
    whole: Path, tmp_path: Path, left: float
) -> None:
    data = whole.read_bytes()
    data = data[: int(left) if left < 0 else int(left * len(data))]
    path = tmp_path / "g.sqlite"
    path.write_bytes(data)
    past, mended = restarted(path, "second")
    assert "g.sqlite was damaged" in mended
    intact = intact_steps(whole, data)
    assert len(intact) > STEPS // 2
    with History(path) as history:
        kept = {step.frame.k: step.frame for step in history.steps()}
    assert intact <= kept.keys()
    assert past.reference_mm is not None
    assert past.last_k is not None
    assert past.last_k >= max(intact)
    for k in kept:
        assert kept[k].inputs.tobytes() == frame(k).inputs.tobytes()


def test_a_row_that_is_cut_off_is_not_taken_for_one_of_the_same_number_and_size_elsewhere(tmp_path: Path) -> None:
    path, content = tmp_path / "a.sqlite", bytes(range(1, 201)) * 5
    with closing(sqlite3.connect(path)) as connection, connection:
        for table in ("whole", "cut"):
            connection.execute(f"CREATE TABLE {table} (id INTEGER PRIMARY KEY, content BLOB)")
            connection.execute(f"INSERT INTO {table} VALUES (7, ?)", (table.encode() + content,))
    path.write_bytes(path.read_bytes()[:-300])
    assert rows_cut_off(path) == {(7, (None, (b"cut" + content)[:-300] + bytes(300)))}


@pytest.mark.parametrize("instead", ["zeros", "the page of another table"])
def test_without_the_pages_that_lead_to_a_table_its_rows_are_found_all_the_same(
    instead: str, whole: Path, tmp_path: Path
) -> None:
    data = bytearray(whole.read_bytes())
    with closing(sqlite3.connect(whole)) as connection:
        inner = "SELECT pageno FROM dbstat WHERE name IN ('frame', 'decision', 'measurement') AND pagetype = 'internal'"
        lost = [number for (number,) in connection.execute(inner)]
    assert len(lost) >= 2
    at = pages_of(whole, "trust")[0]
    content = bytes(PAGE) if instead == "zeros" else data[at : at + PAGE]
    for number in lost:
        data[(number - 1) * PAGE : number * PAGE] = content
    path = tmp_path / "g.sqlite"
    path.write_bytes(data)
    past, _ = restarted(path, "second")
    assert past.last_k == STEPS - 1
    assert past.reference_mm is not None
    with History(path) as history:
        assert len(list(history.steps())) == STEPS + 10
        assert len(history.measurements()) == STEPS // 5 + 2


@pytest.mark.parametrize(("spoilt", "left"), [(0, 5 * PAGE), (1, 5 * PAGE), (0, 0), (0, 15)])
def test_when_the_record_is_lost_learning_goes_on_from_the_newest_copy_that_is_whole(
    spoilt: int, left: int, tmp_path: Path
) -> None:
    path, known = tmp_path / "g.sqlite", []
    settings = two_temperatures(path)
    with Store(path, "first", SteppedClock()) as store:
        store.begin(settings.canonical(), settings.fingerprint(), "")
        controller = earlier_run(store, settings).controller
        for k in range(40):
            write(store, controller, k)
            if k in (20, 39):
                state = controller.state()
                assert state.course is not None
                known.append(state.course.learner.mixture.count.copy())
                store.keep(Snapshot("marks", state, None, {}, (None,) * 9))
                store.flush()
    with History(path) as history:
        first = history.reference()
    assert first is not None
    assert first.centres_mm is not None
    assert not np.array_equal(known[0], known[1])
    for copy in generations(path)[:spoilt]:
        copy.write_bytes(copy.read_bytes()[:-50])
    with path.open("r+b") as file:
        file.truncate(left)
    past, mended = restarted(path, "second")
    assert "learning goes on from the copy" in mended
    learnt = past.controller.state().course
    assert learnt is not None
    assert past.reference_mm is not None
    assert past.reference_mm == pytest.approx(first.centres_mm + first.in_force_um * 1e-3)
    with Store(path, "third", SteppedClock()) as store:
        again = earlier_run(store, settings).controller.state().course
    assert again is not None
    assert np.all(again.learner.mixture.count >= known[1 - spoilt])
    assert list(tmp_path.glob("g.sqlite.damaged-*"))


def test_a_copy_stands_for_its_steps_and_the_record_that_is_left_is_kept(whole: Path, tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    shutil.copy(whole, path)
    settings = two_temperatures(path)
    with Store(path, "second", SteppedClock()) as store:
        controller = earlier_run(store, settings).controller
        store.begin(settings.canonical(), settings.fingerprint(), "")
        store.keep(Snapshot("marks", controller.state(), None, {}, (None,) * 9))
        for k in range(STEPS, STEPS + 10):
            write(store, controller, k)
        store.flush()
    known = controller.state().course
    assert known is not None
    with path.open("r+b") as file:
        file.seek(pages_of(path, "frame")[0])
        file.write(bytes(PAGE))
    past, mended = restarted(path, "third")
    assert mended
    assert past.last_k == STEPS + 9
    course = past.controller.state().course
    assert course is not None
    assert np.array_equal(course.learner.mixture.count, known.learner.mixture.count + 2), "of two later measurements"
    with History(path) as history:
        assert len(list(history.steps())) > STEPS // 2


def test_a_snapshot_from_before_the_copy_is_not_gone_on_from(whole: Path, tmp_path: Path) -> None:
    """Steps between the two are lost: the snapshot lacks what was learnt at these."""
    path, lost = tmp_path / "g.sqlite", range(STEPS, STEPS + 5)
    shutil.copy(whole, path)
    settings = two_temperatures(path)
    with Store(path, "second", SteppedClock()) as store:
        controller = earlier_run(store, settings).controller
        store.begin(settings.canonical(), settings.fingerprint(), "")
        store.keep(Snapshot(marks(settings), controller.state(), None, {}, (None,) * 9))
        for k in lost:
            write(store, controller, k)
        store.keep(Snapshot(marks(settings), controller.state(), None, {}, (None,) * 9))
        store.flush()
    known = controller.state().course
    assert known is not None
    with closing(sqlite3.connect(path)) as connection:
        for table in ("frame", "decision"):
            connection.execute(f"DELETE FROM {table} WHERE k >= ?", (lost.start,))
        connection.commit()
        connection.execute("PRAGMA user_version = 3")
    with Store(path, "third", SteppedClock()) as store:
        assert store.health.mended
        past = earlier_run(store, settings)
    course = past.controller.state().course
    assert past.last_k == lost[-1]
    assert course is not None
    assert np.array_equal(course.learner.mixture.count, known.learner.mixture.count)


def test_with_the_reference_in_the_copy_a_lost_page_of_measurements_costs_only_these(
    whole: Path, tmp_path: Path
) -> None:
    path = tmp_path / "g.sqlite"
    shutil.copy(whole, path)
    settings = two_temperatures(path)
    with Store(path, "second", SteppedClock()) as store:
        state = earlier_run(store, settings).controller.state()
        store.begin(settings.canonical(), settings.fingerprint(), "")
        store.keep(Snapshot("marks", state, None, {}, (None,) * 9))
        store.flush()
    data = bytearray(path.read_bytes())
    for centres_of in (0, 75):
        centres = np.random.default_rng(centres_of).normal(0, 100.0, (6, 3))
        page = data.index(centres.astype("<f8").tobytes()) // PAGE * PAGE
        path.write_bytes(data[:page] + bytes(PAGE) + data[page + PAGE :])
        past, mended = restarted(path, "third")
        assert mended
        assert past.last_k == STEPS - 1
        assert past.reference_mm == pytest.approx(np.random.default_rng(0).normal(0, 100.0, (6, 3)))


def test_when_the_disk_fails_while_a_database_is_mended_nothing_is_changed_and_the_next_start_mends_it(
    whole: Path, tmp_path: Path
) -> None:
    path = tmp_path / "g.sqlite"
    shutil.copy(whole, path)
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("PRAGMA user_version = 3")  # written with 4: the mark in the header says so
    damaged_one = path.read_bytes()
    obstacle = tmp_path / "g.sqlite.new"
    obstacle.mkdir()
    with pytest.raises(OSError, match=r"g\.sqlite\.new"):
        Store(path, "second", SteppedClock())
    assert path.read_bytes() == damaged_one
    assert sorted(tmp_path.iterdir()) == [path, obstacle]
    obstacle.rmdir()
    past, mended = restarted(path, "second")
    assert "g.sqlite was damaged" in mended
    assert past.last_k == STEPS - 1


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


@pytest.mark.slow
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


@pytest.mark.parametrize(
    ("table", "change"),
    [
        ("frame", f"UPDATE frame SET sigma = x'{np.full(9, -0.5).tobytes().hex()}' WHERE k = 70"),
        ("moment", "INSERT INTO moment VALUES (1, 10000000000001, 'origin', 5.0, 0.0, 1)"),
        ("moment", "INSERT INTO moment VALUES (1, -1, 'origin', 5.0, 0.0, 1)"),
    ],
    ids=["negative uncertainty", "step of the far future", "step before 1970"],
)
def test_a_number_that_no_gateway_writes_is_named_with_its_table(
    table: str, change: str, whole: Path, tmp_path: Path
) -> None:
    path = tmp_path / "g.sqlite"
    shutil.copy(whole, path)
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute(change)
    assert [one.split(":")[0] for one in damage_found(path)] == [shown_as(table)]


def test_damage_that_shows_while_it_runs_is_repaired_while_it_runs(whole: Path, tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    shutil.copy(whole, path)
    settings = two_temperatures(path)
    with Store(path, "second", SteppedClock(), commit_s=0.01, retry_s=0.05) as store:
        past = earlier_run(store, settings)
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


@pytest.mark.parametrize("step_s", [0.05, 1.0, 300.0])
def test_the_number_of_a_step_may_be_as_large_as_a_short_step_makes_it(step_s: float, tmp_path: Path) -> None:
    frame, decision = step(round(4.1e9 / step_s))  # in the year 2099
    with Store(tmp_path / "g.sqlite", "boot", SteppedClock()) as store:
        store.begin("{}", "hash", "versions")
        store.record(FrameMade(frame, StepTime(frame.k, "origin", 5.0, 0.0, known=True)))
        store.record(DecisionMade(decision))
    assert damage_found(tmp_path / "g.sqlite") == []


def test_a_flipped_bit_in_the_name_of_a_column_is_damage(whole: Path, tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    path.write_bytes(whole.read_bytes().replace(b"reason TEXT NOT NULL", b"reasoo TEXT NOT NULL"))
    assert check_start(path)


def test_a_flipped_bit_in_one_copy_of_the_configuration_costs_nothing(whole: Path, tmp_path: Path) -> None:
    for table in ("running", "boot"):
        path = tmp_path / f"{table}.sqlite"
        shutil.copy(whole, path)
        with closing(sqlite3.connect(path)) as connection, connection:
            (text,) = connection.execute("SELECT config FROM boot").fetchone()
            connection.execute("INSERT INTO running SELECT NULL, number, began, config, fingerprint FROM boot")
            connection.execute(f"UPDATE {table} SET config = ?", (text.replace('"telemetry":', '"telemetrx":'),))
        past, mended = restarted(path, "second")
        assert (past.last_k, mended) == (STEPS - 1, "")


@pytest.mark.slow
@pytest.mark.parametrize("number", [1 + 2**20, pytest.param(-1, marks=pytest.mark.slow)], ids=str)
def test_a_flipped_bit_in_the_number_of_a_run_costs_nothing_but_raw_readings(
    number: int, whole: Path, tmp_path: Path
) -> None:
    path = tmp_path / "g.sqlite"
    shutil.copy(whole, path)
    restarted(path, "second")
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("UPDATE boot SET number = ? WHERE number = 1", (number,))
    past, mended = restarted(path, "third")
    assert past.last_k == STEPS + 10 - 1, "both runs"
    assert bool(mended) == (number > 0)  # a lower one is never given again
    assert not restarted(path, "fourth")[1]
    with closing(sqlite3.connect(path)) as connection:
        runs = connection.execute("SELECT number, id FROM boot ORDER BY id").fetchall()
    assert len({one for one, _ in runs}) == 4
    if mended:
        assert sorted(one for one, _ in runs) == [1, 2, 3, 4]


def test_the_configuration_of_a_start_is_read_from_its_other_copy(whole: Path, tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    shutil.copy(whole, path)
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("INSERT INTO running SELECT NULL, number, began, config, fingerprint FROM boot")
        connection.execute("UPDATE boot SET config = CAST(x'ff' || config AS TEXT)")
    past, mended = restarted(path, "second")
    assert mended
    assert past.last_k == STEPS - 1
    assert not restarted(path, "third")[1]


def test_without_a_configuration_learning_begins_again(whole: Path, tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    shutil.copy(whole, path)
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("UPDATE boot SET config = replace(config, '\"telemetry\":', '\"telemetrx\":')")
    past, mended = restarted(path, "second")
    assert past.last_k is None
    assert "learning begins again" in mended
    assert not restarted(path, "third")[1]


@pytest.mark.slow
def test_frames_that_are_of_no_run_are_damage(whole: Path, tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    shutil.copy(whole, path)
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("UPDATE frame SET boot = 'compensation', inputs = zeroblob(72) WHERE k = 70")
    assert check_start(path)
    with History(path) as history:
        assert 70 not in {step.frame.k for step in history.steps()}


@pytest.mark.parametrize("version", [0, 5])
def test_a_spoilt_schema_version_is_damage_and_not_another_programs_file(
    whole: Path, tmp_path: Path, version: int
) -> None:
    path = tmp_path / "g.sqlite"
    shutil.copy(whole, path)
    with closing(sqlite3.connect(path)) as connection:
        connection.execute(f"PRAGMA user_version = {version}")
    past, mended = restarted(path, "second")
    assert f"states schema version {version}, but was written with another" in mended
    assert past.last_k == STEPS - 1


def test_a_store_from_before_the_second_version_gets_one(whole: Path, tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    shutil.copy(whole, path)
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("PRAGMA application_id = 0")
    assert restarted(path, "second")[1] == ""
    with closing(sqlite3.connect(path)) as connection:
        assert connection.execute("PRAGMA application_id").fetchone()[0].to_bytes(4) == b"TAL\x04"
