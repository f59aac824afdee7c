"""Stored readings of a span, page by page: every one once, whatever the size of a page, while the gateway writes."""

import math
from contextlib import closing
from datetime import datetime, timedelta
from pathlib import Path

import pytest

from drivers.base import Quality
from gateway.model.events import ReadingsTaken
from gateway.model.sample import Sample
from gateway.storage.faults import StoreError
from gateway.storage.pages import ReadingsPage, readings_page
from gateway.storage.readings import Pruning, Retention
from gateway.storage.schema import connect
from gateway.storage.store import Store
from tests.benches.stepped_clock import EPOCH, SteppedClock

CHANNELS = ("a", "b", "c")
LONG = timedelta(days=1)


def after(seconds: float) -> datetime:
    return EPOCH + timedelta(seconds=seconds)


def write(path: Path, boot: str, times_s: range) -> None:
    """One reading of each channel at each time; `c` is broken. The value of `a` is the time."""
    with Store(path, boot, SteppedClock()) as store:
        put(store, times_s)


def put(store: Store, times_s: range) -> None:
    for sequence, at_s in enumerate(times_s, start=1):
        readings = [
            Sample("a", float(at_s), "degC", Quality.GOOD, after(at_s), 0.0, sequence=sequence),
            Sample("b", -1.5, "um", Quality.GOOD, after(at_s + 0.25), 0.0, sequence=sequence),
            Sample("c", math.nan, "degC", Quality.SENSOR_FAULT, after(at_s), 0.0, sequence=sequence),
        ]
        store.record(ReadingsTaken(readings))


def all_of(
    path: Path, begin: datetime, end: datetime, channels: tuple[str, ...] | None, limit: int
) -> list[ReadingsPage]:
    pages = [readings_page(path, begin, end, channels, limit)]
    while (following := pages[-1].next) is not None:
        pages.append(readings_page(path, begin, end, channels, limit, following))
    return pages


def times(pages: list[ReadingsPage], channel: str) -> list[float]:
    """Seconds after EPOCH at which a channel was read."""
    return [
        time - EPOCH.timestamp()
        for page in pages
        for time, at in zip(page.time, page.channel, strict=True)
        if page.names[at] == channel
    ]


def test_every_reading_of_the_span_comes_once_and_in_order_over_two_runs(tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    write(path, "first", range(0, 40, 2))
    write(path, "second", range(40, 80, 2))
    for limit in (1, 7, 60, 1000):
        pages = all_of(path, after(10.0), after(70.0), None, limit)
        assert times(pages, "a") == list(range(10, 70, 2))
        assert times(pages, "b") == [at + 0.25 for at in range(10, 70, 2)]
        assert max(len(page.time) for page in pages) <= limit
        assert {page.period_s for page in pages if page.time} == {0.0}


def test_the_span_begins_with_its_first_instant_and_ends_before_its_last(tmp_path: Path) -> None:
    write(tmp_path / "g.sqlite", "first", range(10))
    assert times(all_of(tmp_path / "g.sqlite", after(3.0), after(5.0), ("a",), 100), "a") == [3.0, 4.0]


def test_a_page_has_values_units_and_qualities_and_null_for_what_does_not_exist(tmp_path: Path) -> None:
    write(tmp_path / "g.sqlite", "first", range(2))
    page = all_of(tmp_path / "g.sqlite", EPOCH, after(1.0), None, 100)[-1]
    assert (page.names, page.units) == (CHANNELS, ("degC", "um", "degC"))
    assert (page.channel, page.value) == ([0, 1, 2], [0.0, -1.5, None])
    assert page.quality == ["good", "good", "sensor_fault"]


def test_only_the_wanted_channels_come(tmp_path: Path) -> None:
    write(tmp_path / "g.sqlite", "first", range(20))
    pages = all_of(tmp_path / "g.sqlite", EPOCH, after(20.0), ("b",), 6)
    assert times(pages, "b") == [at + 0.25 for at in range(20)]
    assert times(pages, "a") == []


def test_a_span_without_readings_is_one_empty_page(tmp_path: Path) -> None:
    write(tmp_path / "g.sqlite", "first", range(3))
    for begin, end in ((after(-9000.0), after(-8000.0)), (after(8000.0), after(9000.0))):
        assert [page.time for page in all_of(tmp_path / "g.sqlite", begin, end, None, 10)] == [[]]


def test_a_reading_that_comes_while_pages_are_read_is_in_the_last_one(tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    with Store(path, "first", SteppedClock()) as store:
        put(store, range(4))
        store.flush()
        first = readings_page(path, EPOCH, after(LONG.total_seconds()), ("a",), 3)
        store.record(ReadingsTaken([Sample("a", 9.0, "degC", Quality.GOOD, after(9.0), 0.0, sequence=9)]))
        store.flush()
        second = readings_page(path, EPOCH, after(LONG.total_seconds()), ("a",), 3, first.next)
    assert times([first, second], "a") == [0.0, 1.0, 2.0, 3.0, 9.0]
    assert second.next is None


def test_what_was_thinned_comes_first_as_means_of_minutes(tmp_path: Path) -> None:
    path, day_s = tmp_path / "g.sqlite", 86400.0
    write(path, "first", range(0, 120, 10))
    with closing(connect(path)) as connection:
        pruning = Pruning(Retention(samples_days=1.0), 0.0)
        pruning.prune(connection, 3600.0)
        connection.commit()
        write(path, "second", range(int(2 * day_s), int(2 * day_s) + 30, 10))
        pruning.prune(connection, 2 * day_s)
        connection.commit()
    pages = all_of(path, EPOCH, after(10 * day_s), ("a",), 2)
    found = [(page.period_s, value) for page in pages for value in page.value]
    assert found == [(60.0, 25.0), (60.0, 85.0), *((0.0, 2 * day_s + at) for at in (0.0, 10.0, 20.0))]
    assert times(pages, "a") == [0.0, 60.0, 2 * day_s, 2 * day_s + 10.0, 2 * day_s + 20.0]


@pytest.mark.parametrize(
    ("channels", "following", "said"),
    [
        (("bed",), None, "channels: 'bed' was never stored; stored are: a, b, c"),
        (None, "r", "after = 'r': expected `next`"),
        (None, "x12", "after = 'x12': expected `next`"),
        (None, "m" + "9" * 30, "expected `next`"),
        (None, f"m{2**63 - 1}", "expected `next`"),
        (None, f"r{2**63}", "expected `next`"),
    ],
)
def test_a_wrong_question_is_answered_in_words(
    tmp_path: Path, channels: tuple[str, ...] | None, following: str | None, said: str
) -> None:
    write(tmp_path / "g.sqlite", "first", range(2))
    with pytest.raises(ValueError, match=said):
        readings_page(tmp_path / "g.sqlite", EPOCH, after(1.0), channels, 10, following)


def test_a_file_that_is_no_database_or_not_there_is_an_error_of_the_store(tmp_path: Path) -> None:
    other = tmp_path / "other.sqlite"
    with pytest.raises(StoreError, match="no such file"):
        readings_page(other, EPOCH, after(1.0), None, 10)
    other.write_bytes(b"nothing of the kind" * 1000)
    with pytest.raises(StoreError, match="not a database of this gateway"):
        readings_page(other, EPOCH, after(1.0), None, 10)


def test_reading_pages_leaves_the_file_as_it_was(tmp_path: Path) -> None:
    """It leaves no lock that a gateway would wait for, and no file beside it."""
    path = tmp_path / "g.sqlite"
    write(path, "first", range(5))
    before = path.read_bytes(), sorted(file.name for file in tmp_path.iterdir() if "-" not in file.name)
    all_of(path, EPOCH, after(9.0), None, 2)
    assert (path.read_bytes(), sorted(f.name for f in tmp_path.iterdir() if "-" not in f.name)) == before
