"""Means of intervals are those of the readings, wherever the store has them and whatever the size of a page."""

import math
import sqlite3
from collections import defaultdict
from contextlib import closing
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from drivers.base import Quality
from gateway.model.events import ReadingsTaken
from gateway.model.sample import Sample
from gateway.storage.mean_pages import means_page
from gateway.storage.readings import Pruning, Retention
from gateway.storage.schema import connect
from gateway.storage.store import Store
from tests.benches.stepped_clock import EPOCH, SteppedClock

DAY_S = 86400.0
BEGIN = EPOCH.replace(hour=6, minute=0, second=0, microsecond=0)

MeanValues = dict[tuple[float, str], float]


def readings(first_s: float, last_s: float) -> list[Sample]:
    """Readings of three channels, two of which are read at other times; some are not good, and `c` is silent for a
    while. Every third read of `b` comes late: after those of the next second."""
    random = np.random.default_rng(int(first_s))
    found = []
    for at_s in np.arange(first_s, last_s, 7.0):
        a, b, c = random.normal(20.0, 5.0, 3)
        bad = random.random() < 0.1
        found.append((at_s, "a", a, Quality.GOOD))
        found.append((at_s + (8.5 if random.random() < 0.3 else 0.25), "b", b, Quality.STALE if bad else Quality.GOOD))
        if not 1000.0 < at_s < 2200.0:
            found.append((at_s, "c", math.nan if bad else c, Quality.SENSOR_FAULT if bad else Quality.GOOD))
    return [
        Sample(channel, value, "degC", quality, BEGIN + timedelta(seconds=at_s), 0.0, sequence=number)
        for number, (at_s, channel, value, quality) in enumerate(found, start=1)
    ]


def expected(
    taken: list[Sample], begin: datetime, end: datetime, every_s: int, *, by_minute: bool = False
) -> MeanValues:
    """The means computed by hand. by_minute: a reading counts where its minute begins."""
    found = defaultdict[tuple[float, str], list[float]](list)
    for sample in taken:
        at = sample.source_time.replace(second=0, microsecond=0) if by_minute else sample.source_time
        if sample.quality is Quality.GOOD and begin <= at < end:
            interval = (at - begin) // timedelta(seconds=every_s)
            found[begin.timestamp() + interval * every_s, sample.channel].append(sample.value)
    return {key: float(np.mean(values)) for key, values in found.items()}


def means_of(
    path: Path, begin: datetime, end: datetime, every_s: int, limit: int = 1000, channels: tuple[str, ...] | None = None
) -> MeanValues:
    """The means of all pages."""
    found, after = MeanValues(), None
    while True:
        page = means_page(path, begin, end, channels, limit, every_s, after)
        assert page.period_s == every_s
        assert set(page.quality) <= {"good"}
        assert len(page.time) <= max(limit, len(page.names))
        for time, at, value in zip(page.time, page.channel, page.value, strict=True):
            assert value is not None
            assert (time, page.names[at]) not in found
            found[time, page.names[at]] = value
        if page.next is None:
            return found
        after = page.next


def write(path: Path, boot: str, taken: list[Sample]) -> None:
    with Store(path, boot, SteppedClock()) as store:
        store.record(ReadingsTaken(taken))


@pytest.fixture
def stored(tmp_path: Path) -> tuple[Path, list[Sample]]:
    """Two runs; there are means of the first run's readings already, because the second was started."""
    path = tmp_path / "g.sqlite"
    first, second = readings(0.0, 3000.0), readings(40_000.0, 42_000.0)
    write(path, "first", first)
    write(path, "second", second)
    with closing(sqlite3.connect(path)) as connection:
        (of_first,) = connection.execute("SELECT count(*) FROM reading WHERE id <= (SELECT max(upto) FROM gathered)")
    assert of_first == (len(first),)
    return path, first + second


@pytest.mark.parametrize("every_s", [45, 60, 600, 3600])
@pytest.mark.parametrize("limit", [20, 50_000])
def test_means_are_those_of_the_readings(every_s: int, limit: int, stored: tuple[Path, list[Sample]]) -> None:
    path, taken = stored
    for first_s, last_s in ((0, 50_000), (60, 41_040), (39_960, 40_500)):
        begin, end = BEGIN + timedelta(seconds=first_s), BEGIN + timedelta(seconds=last_s)
        found = means_of(path, begin, end, every_s, limit)
        assert found == pytest.approx(expected(taken, begin, end, every_s))
        only = means_of(path, begin, end, every_s, limit, ("c",))
        assert only == {key: value for key, value in found.items() if key[1] == "c"}


def test_a_minute_counts_where_it_begins_and_other_intervals_have_the_readings_themselves(
    stored: tuple[Path, list[Sample]],
) -> None:
    path, taken = stored
    begin, end = BEGIN + timedelta(seconds=90.5), BEGIN + timedelta(seconds=41_000)
    assert means_of(path, begin, end, 120) == pytest.approx(expected(taken, begin, end, 120, by_minute=True))
    assert means_of(path, begin, end, 50) == pytest.approx(expected(taken, begin, end, 50))


def test_means_stay_the_same_while_readings_are_gathered_and_thinned(stored: tuple[Path, list[Sample]]) -> None:
    path, taken = stored
    end = BEGIN + timedelta(days=2)
    before = means_of(path, BEGIN, end, 60)
    assert before == pytest.approx(expected(taken, BEGIN, end, 60))
    counts, whole = list[int](), before
    with closing(connect(path)) as connection:
        pruning = Pruning(Retention(samples_days=1.0), 0.0)
        for hours in range(2, 60, 6):  # each mark, a day later, deletes what was there
            if hours < 20:
                more = readings(50_000.0 + 1000.0 * hours, 50_800.0 + 1000.0 * hours)
                write(path, f"after {hours} h", more)
                whole = whole | expected(more, BEGIN, end, 60)
            pruning.prune(connection, hours * 3600.0)
            connection.commit()
            assert means_of(path, BEGIN, end, 60) == pytest.approx(whole)
            counts += connection.execute("SELECT count(*) FROM reading").fetchone()
        assert connection.execute("SELECT count(*) FROM recent_minute").fetchone()[0] <= 1
    assert len(set(counts)) > 4, "some are in means beside readings, some instead of them"
    assert counts[-1] == 1, "the newest stays"


def test_means_of_readings_of_which_only_some_are_thinned_stay_the_same(tmp_path: Path) -> None:
    path, end = tmp_path / "g.sqlite", BEGIN + timedelta(days=1)
    taken = readings(0.0, 3000.0)
    write(path, "first", taken)
    with closing(connect(path)) as connection:
        connection.executescript("DELETE FROM gathered; DELETE FROM recent_minute; DELETE FROM mark;")
        connection.execute(
            "INSERT INTO mark SELECT NULL, 3600.0, id, 0, -1, 0 FROM reading ORDER BY id LIMIT 1 OFFSET 699"
        )
        pruning = Pruning(Retention(samples_days=1.0), 0.0)
        pruning.prune(connection, 19 * 3600.0)
        pruning.prune(connection, 25 * 3600.0)
        connection.commit()
        left = connection.execute("SELECT count(*) FROM reading").fetchone()
        assert left == (len(taken) - 700,)
    assert means_of(path, BEGIN, end, 60) == pytest.approx(expected(taken, BEGIN, end, 60))


@pytest.mark.slow
def test_a_page_ends_before_too_many_readings_are_looked_at(tmp_path: Path) -> None:
    path, times = tmp_path / "g.sqlite", 600_000
    write(path, "first", readings(0.0, 1.0)[:1])
    with closing(connect(path)) as connection:
        connection.execute(
            f"WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < {times})"
            " INSERT INTO reading SELECT (SELECT max(id) FROM reading) + i * 2048, ? + i / 100.0, i, 0, NULL FROM n",
            (BEGIN.timestamp(),),
        )
        connection.commit()
    end = BEGIN + timedelta(seconds=times / 100 + 1)
    page = means_page(path, BEGIN, end, None, 50_000, 10)
    assert page.next is not None
    assert 400 < len(page.time) <= 500, "of 10 s, 1000 readings each"
    assert len(means_of(path, BEGIN, end, 10)) == times / 1000 + 1


def test_a_database_of_an_earlier_program_is_read_without_means(stored: tuple[Path, list[Sample]]) -> None:
    path, taken = stored
    with closing(connect(path)) as connection:
        connection.executescript("DROP TABLE gathered; DROP TABLE recent_minute;")
    end = BEGIN + timedelta(days=1)
    assert means_of(path, BEGIN, end, 60) == pytest.approx(expected(taken, BEGIN, end, 60))


def test_a_long_time_without_readings_takes_no_pages(tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    write(path, "first", readings(0.0, 100.0))
    write(path, "second", readings(300 * DAY_S, 300 * DAY_S + 100.0))
    pages, after, end = 0, None, BEGIN + timedelta(days=400)
    while pages == 0 or after is not None:
        after = means_page(path, BEGIN - timedelta(days=400), end, None, 30, 60, after).next
        pages += 1
    assert pages <= 4


@pytest.mark.parametrize("after", ["e", "r5", "e-1", "e٣", "e" + "9" * 30])
def test_a_place_that_no_page_gave_is_refused(after: str, stored: tuple[Path, list[Sample]]) -> None:
    with pytest.raises(ValueError, match="expected `next` of the previous page"):
        means_page(stored[0], BEGIN, BEGIN + timedelta(days=1), None, 10, 60, after)


def test_a_place_behind_the_end_is_an_empty_last_page(stored: tuple[Path, list[Sample]]) -> None:
    page = means_page(stored[0], BEGIN, BEGIN + timedelta(days=1), None, 10, 60, "e" + "9" * 18)
    assert (page.time, page.next) == ([], None)
