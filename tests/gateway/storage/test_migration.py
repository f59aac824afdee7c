"""A database of every earlier schema version is brought to the present one, in place and with a backup."""

import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

from gateway.model.events import DecisionMade, FrameMade, ReadingsTaken
from gateway.storage.faults import StoreError
from gateway.storage.history import History
from gateway.storage.schema import SCHEMA_VERSION
from gateway.storage.store import Store
from tests.benches import telemetry_examples as example
from tests.benches.stepped_clock import SteppedClock

VERSIONS = range(1, SCHEMA_VERSION)


def of_version(version: int, path: Path) -> Path:
    """A database as a program of that version left it; the dumps are never renewed."""
    with closing(sqlite3.connect(path)) as connection:
        connection.executescript(Path(__file__).with_name(f"version{version}.sql").read_text(encoding="utf-8"))
    return path


def tables(path: Path) -> list[tuple[str, str]]:
    with closing(sqlite3.connect(path)) as connection:
        names = [n for (n,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table' ORDER BY name")]
        return [(name, column) for name in names for _, column, *_ in connection.execute(f"PRAGMA table_info({name})")]


@pytest.mark.parametrize("version", VERSIONS)
def test_it_is_migrated_read_and_continued(version: int, tmp_path: Path) -> None:
    path = of_version(version, tmp_path / "g.sqlite")
    with Store(path, "boot-2", SteppedClock()) as store:
        assert store.migrated_from == tmp_path / f"g.sqlite.version{version}"
        store.begin("{}", "hash", "versions")
        store.record(FrameMade(replace(example.FRAME, k=9)))
        store.record(DecisionMade(replace(example.DECISION, k=9)))
    with History(path) as history:
        assert [step.frame.k for step in history.steps()] == [7, 8, 9]
        assert [m.number for m in history.measurements()] == [41, 43, 42]
        assert history.channel_health() == {"bed_front": {"good": 1}, "Öl": {"sensor_fault": 1}}
        assert len(history.compensation()) == 2
        assert history.config() == ("{}", "hash", "versions")
    with closing(sqlite3.connect(path)) as connection:
        assert connection.execute("SELECT number, id FROM boot ORDER BY number").fetchall() == [
            (1, "boot-1"), (2, "boot-2"),
        ]  # fmt: skip
    with Store(path, "boot-3", SteppedClock()) as store:
        assert store.migrated_from is None


def test_the_tables_of_later_programs_are_added_without_a_migration(tmp_path: Path) -> None:
    """Such as the first program of the present version left it."""
    path = of_version(SCHEMA_VERSION, tmp_path / "g.sqlite")
    before = tables(path)
    with Store(path, "boot-2", SteppedClock()) as store:
        assert store.migrated_from is None
        store.begin("{}", "hash", "versions")
        store.record(ReadingsTaken((example.READING, example.BAD_READING)))
        store.record(FrameMade(replace(example.FRAME, k=9)))
        store.record(DecisionMade(replace(example.DECISION, k=9)))
    assert len(before) < len(tables(path))
    with History(path) as history:
        assert [step.frame.k for step in history.steps()] == [7, 8, 9]
        assert [m.number for m in history.measurements()] == [41, 43, 42]
        assert history.channel_health() == {"bed_front": {"good": 2}, "Öl": {"sensor_fault": 2}}
        assert len(history.events()) == 3
    with closing(sqlite3.connect(path)) as connection:
        assert connection.execute("SELECT channel, quality FROM sample").fetchall() == [
            ("bed_front", "good"), ("Öl", "sensor_fault"),
        ]  # fmt: skip


@pytest.mark.parametrize("version", [*VERSIONS, SCHEMA_VERSION])
def test_its_tables_are_those_of_a_new_database(version: int, tmp_path: Path) -> None:
    path, new = of_version(version, tmp_path / "g.sqlite"), tmp_path / "new.sqlite"
    for one in (path, new):
        with Store(one, "boot", SteppedClock()):
            pass
    assert [t for t in tables(path) if t[0] != "sample_before"] == tables(new)


@pytest.mark.parametrize("version", VERSIONS)
def test_the_backup_is_of_the_earlier_version_and_can_be_migrated_itself(version: int, tmp_path: Path) -> None:
    path = of_version(version, tmp_path / "g.sqlite")
    with closing(sqlite3.connect(path)) as connection:
        before = connection.execute("SELECT * FROM frame").fetchall()
        found = tables(path)
    with Store(path, "boot-2", SteppedClock()) as store:
        backup = store.migrated_from
    assert backup is not None
    assert tables(backup) == found
    with closing(sqlite3.connect(backup)) as connection:
        assert connection.execute("PRAGMA user_version").fetchone() == (version,)
        assert connection.execute("SELECT * FROM frame").fetchall() == before
    with Store(backup, "boot-3", SteppedClock()), History(backup) as history:
        assert [step.frame.k for step in history.steps()] == [7, 8]


def test_a_migration_that_fails_leaves_the_database_as_it_was(tmp_path: Path) -> None:
    path = of_version(3, tmp_path / "g.sqlite")
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("CREATE TABLE minute (of_another INTEGER)")
    with pytest.raises(StoreError, match="minute"):
        Store(path, "boot-2", SteppedClock())
    with closing(sqlite3.connect(path)) as connection:
        assert connection.execute("PRAGMA user_version").fetchone() == (3,)
        assert connection.execute("SELECT count(*) FROM sample").fetchone() == (2,)


def test_a_database_of_a_newer_program_is_left_alone(tmp_path: Path) -> None:
    path = of_version(3, tmp_path / "g.sqlite")
    with closing(sqlite3.connect(path)) as connection:
        connection.execute(f"PRAGMA user_version = {SCHEMA_VERSION + 1}")
    before = tables(path)
    with pytest.raises(StoreError, match="use a newer program"):
        Store(path, "boot-2", SteppedClock())
    assert tables(path) == before
