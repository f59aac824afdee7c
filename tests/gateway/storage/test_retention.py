"""How long rows stay: by the time that the gateway has run, whatever the wall clock says, and by size."""

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from drivers.base import Quality
from gateway.config.sections import Storage
from gateway.model.compensation import Source, Step, Write
from gateway.model.events import CompensationStepped, DecisionMade, FrameMade, ReadingsTaken
from gateway.model.sample import Sample
from gateway.storage.history import History
from gateway.storage.readings import Channels, Pruning, Retention
from gateway.storage.schema import connect, make_schema
from gateway.storage.store import Store
from talc.frame import Decision, Frame, Phase
from tests.benches.stepped_clock import EPOCH, SteppedClock

DAY, HOUR = 86400.0, 3600.0
STILL = Step((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), Source.NO_MODEL, (False, False, False))


@pytest.fixture
def database(tmp_path: Path) -> Iterator[sqlite3.Connection]:
    make_schema(tmp_path / "g.sqlite")
    with closing(connect(tmp_path / "g.sqlite")) as connection:
        yield connection


def read(database: sqlite3.Connection, sequence: int, times: datetime, *values: float, good: bool = True) -> None:
    quality = Quality.GOOD if good else Quality.SENSOR_FAULT
    found = [Sample("a", v, "degC", quality, times, 0.0, sequence=sequence + i) for i, v in enumerate(values)]
    channels = Channels([])
    database.executemany("INSERT OR IGNORE INTO channel VALUES (?, ?, ?)", channels.new(found))
    database.executemany("INSERT INTO reading VALUES (?, ?, ?, ?, ?)", channels.readings(1, found))


def sequences(database: sqlite3.Connection) -> list[int]:
    return [sequence for (sequence,) in database.execute("SELECT sequence FROM sample ORDER BY sequence")]


def minutes(database: sqlite3.Connection) -> list[tuple[float, ...]]:
    return database.execute("SELECT channel, time, count, mean, low, high FROM minute ORDER BY id").fetchall()


def test_old_readings_become_minute_statistics(database: sqlite3.Connection) -> None:
    pruning = Pruning(Retention(samples_days=7.0), 0.0)
    start = EPOCH.replace(second=0)
    read(database, 1, start, 20.0, 21.0, 25.0)
    read(database, 4, start + timedelta(seconds=60), 30.0)
    read(database, 5, start + timedelta(seconds=60), 99.0, good=False)
    pruning.prune(database, HOUR)
    read(database, 6, start + timedelta(days=6), 40.0)
    pruning.prune(database, 6 * DAY)
    assert sequences(database) == [1, 2, 3, 4, 5, 6]
    pruning.prune(database, 7.1 * DAY)
    assert sequences(database) == [6]
    at = int(start.timestamp())
    assert minutes(database) == [(1, at, 3, 22.0, 20.0, 25.0), (1, at + 60, 1, 30.0, 30.0, 30.0)]


@pytest.mark.parametrize("jump", [timedelta(days=8), timedelta(days=-8), timedelta(days=-20000), timedelta(days=29000)])
def test_a_clock_that_jumps_deletes_no_reading(jump: timedelta, database: sqlite3.Connection) -> None:
    """From 2026 to 1971 and to 2105, and eight days either way."""
    pruning = Pruning(Retention(samples_days=7.0), 0.0)
    for hour in range(48):
        now = EPOCH + timedelta(hours=hour) + (jump if hour > 20 else timedelta())
        read(database, hour, now, 20.0)
        pruning.prune(database, hour * HOUR)
    assert sequences(database) == list(range(48))


def test_the_time_of_running_counts_over_restarts_and_not_the_time_between(tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    for run in range(5):  # two days each, and a year off between
        clock = SteppedClock()
        clock.spend(run * 365 * DAY)
        with Store(path, f"boot{run}", clock, retention=Retention(samples_days=5.0)) as store:
            sample = Sample("a", 20.0, "degC", Quality.GOOD, clock.utc(), 0.0, sequence=run)
            store.record(ReadingsTaken([sample]))
            store.record(CompensationStepped(Write(clock.utc(), "monitor", STILL, None, {}, False, None)))
            frame = Frame(run, np.zeros(2), np.ones(2, np.bool_))
            store.record(FrameMade(frame))
            nine = np.zeros(9)
            store.record(DecisionMade(Decision(run, Phase.CALIBRATION, nine, nine, nine, nine, None, None, ())))
            store.flush()
            clock.spend(2 * DAY)
    with Store(path, "last", clock, retention=Retention(samples_days=5.0)):
        pass
    with closing(sqlite3.connect(path)) as connection:
        assert sequences(connection) == [2, 3, 4]
        assert connection.execute("SELECT count(*) FROM compensation").fetchone() == (3,)
    with History(path) as history:
        assert [step.frame.k for step in history.steps()] == list(range(5)), "what was learnt from stays"


def test_minute_statistics_go_after_their_own_time(database: sqlite3.Connection) -> None:
    pruning = Pruning(Retention(samples_days=1.0, minutes_days=10.0), 0.0)
    for hour in range(0, 20 * 24, 6):
        read(database, hour, EPOCH + timedelta(hours=hour), 20.0)
        pruning.prune(database, hour * HOUR)
    kept = len(minutes(database)) + len(sequences(database))
    assert 10 * 4 <= kept <= 12 * 4


def test_by_default_readings_stay_for_a_week_and_minutes_for_four_hundred_days(database: sqlite3.Connection) -> None:
    settings = Storage()
    keep = Retention(
        samples_days=settings.keep_samples_days, minutes_days=settings.keep_minutes_days, most_mb=settings.most_mb
    )
    pruning = Pruning(keep, 0.0)
    start = EPOCH.replace(second=0)
    for number, minute in enumerate(range(3), start=1):
        read(database, number, start + timedelta(minutes=minute), 20.0)
    pruning.prune(database, HOUR)
    pruning.prune(database, 7.0 * DAY)
    assert sequences(database) == [1, 2, 3]
    pruning.prune(database, 7.1 * DAY)
    assert sequences(database) == [3]
    for day, left in ((8.0, 2), (407.9, 2), (408.1, 1)):
        pruning.prune(database, day * DAY)
        assert len(minutes(database)) == left, day


def test_a_database_that_is_too_large_thins_the_oldest_readings_before_their_time(tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    make_schema(path)
    with closing(connect(path)) as database:
        pruning = Pruning(Retention(most_mb=0.5), 0.0)
        for hour in range(40):
            read(database, hour * 1000, EPOCH + timedelta(hours=hour), *[20.0] * 1000)
            pruning.prune(database, hour * HOUR)
        database.commit()
        left = sequences(database)
        assert 5_000 < len(left) < 39_000
        assert left == list(range(40_000 - len(left), 40_000))
        pages, free = (database.execute(f"PRAGMA {name}").fetchone()[0] for name in ("page_count", "freelist_count"))
        assert (pages - free) * 4096 < 0.6e6


def test_the_newest_row_stays_so_that_no_number_is_given_twice(database: sqlite3.Connection) -> None:
    pruning = Pruning(Retention(samples_days=1.0), 0.0)
    read(database, 1, EPOCH, 20.0, 21.0)
    pruning.prune(database, HOUR)
    pruning.prune(database, 3 * DAY)
    pruning.prune(database, 9 * DAY)
    assert sequences(database) == [2]
