"""Pages of blocks contain the same readings as pages of rows, wherever the store has them and whatever is asked for."""

import math
import sqlite3
from contextlib import closing
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from drivers.base import Quality
from gateway.model.events import ReadingsTaken
from gateway.model.reading_blocks import DamagedBlock, ReadingBlock, pack, unpack
from gateway.model.sample import Sample
from gateway.storage.block_pages import blocks_page
from gateway.storage.pages import readings_page
from gateway.storage.readings import QUALITIES, Pruning, Retention
from gateway.storage.schema import connect
from gateway.storage.store import Store
from tests.benches.stepped_clock import EPOCH, SteppedClock

BEGIN = EPOCH.replace(hour=6, minute=0, second=0, microsecond=0)
ALWAYS = BEGIN - timedelta(days=1), BEGIN + timedelta(days=9)
NAMES = ("a", "b", "c")

FoundReading = tuple[float, float, str, float | None, str]
"""Period, time, channel, value, quality."""


def readings(first_s: float, last_s: float) -> list[Sample]:
    """Readings of three channels; some are not good, some have no value, and those of `b` come in another order."""
    random = np.random.default_rng(int(first_s))
    found = []
    for number, at_s in enumerate(np.arange(first_s, last_s, 1.0), start=1):
        for name, value in zip(NAMES, random.normal(20.0, 5.0, 3), strict=True):
            quality = [Quality.GOOD, Quality.STALE, Quality.SENSOR_FAULT][int(random.random() * 1.2 + random.random())]
            time = BEGIN + timedelta(seconds=at_s + (2.5 if name == "b" and random.random() < 0.3 else 0.0))
            taken = math.nan if quality is Quality.SENSOR_FAULT else value
            found.append(Sample(name, taken, "degC", quality, time, 0.0, sequence=number))
    return found


@pytest.fixture
def stored(tmp_path: Path) -> Path:
    """Two runs: there are blocks of the first, as the second began by making them, and none of the second."""
    path = tmp_path / "g.sqlite"
    for boot, first_s, last_s in (("first", 0.0, 600.0), ("second", 4000.0, 4300.0)):
        with Store(path, boot, SteppedClock()) as store:
            store.record(ReadingsTaken(readings(first_s, last_s)))
    with closing(sqlite3.connect(path)) as connection:
        assert connection.execute("SELECT sum(rows) FROM reading_block").fetchone() == (1800,)
    return path


def in_rows(path: Path, begin: datetime, end: datetime, channels: tuple[str, ...] | None = None) -> list[FoundReading]:
    page = readings_page(path, begin, end, channels, 50_000)
    found = list[FoundReading]()
    while True:
        columns = page.time, page.channel, page.value, page.quality
        found += [(page.period_s, t, page.names[c], v, q) for t, c, v, q in zip(*columns, strict=True)]
        if page.next is None:
            return found
        page = readings_page(path, begin, end, channels, 50_000, page.next)


def in_blocks(
    path: Path, begin: datetime, end: datetime, channels: tuple[str, ...] | None = None, limit: int = 50_000
) -> list[FoundReading]:
    found, after = list[FoundReading](), None
    while True:
        page = blocks_page(path, begin, end, channels, limit, after)
        name_of = dict(zip(page.numbers, page.names, strict=True))
        for block in page.blocks:
            columns = unpack(block)
            assert (block.first_s, block.last_s) == (columns.time.min(), columns.time.max())
            for t, c, v, q in zip(*(column.tolist() for column in columns), strict=True):
                found.append((page.period_s, t, name_of[c], None if math.isnan(v) else v, QUALITIES[q].value))
        assert sum(block.rows for block in page.blocks[:-1]) < limit
        if page.next is None:
            return found
        after = page.next


@pytest.mark.parametrize("limit", [7, 50_000])
def test_blocks_hold_what_rows_do(stored: Path, limit: int) -> None:
    for first_s, last_s in ((-10.0, 5000.0), (0.0, 600.0), (100.5, 101.5), (590.0, 4010.0), (700.0, 3000.0)):
        span = BEGIN + timedelta(seconds=first_s), BEGIN + timedelta(seconds=last_s)
        for channels in (None, ("b",), ("c", "a")):
            assert in_blocks(stored, *span, channels, limit) == in_rows(stored, *span, channels), (span, channels)
    assert len(in_rows(stored, *ALWAYS)) == 2700


def test_blocks_that_are_wanted_whole_go_out_as_they_are_stored(stored: Path) -> None:
    with closing(sqlite3.connect(stored)) as connection:
        columns = "rows, first, last, time, channel, value, quality"
        (kept,) = connection.execute(f"SELECT {columns} FROM reading_block").fetchall()
    first, second = blocks_page(stored, *ALWAYS, None, 50_000).blocks
    assert first == kept
    assert second.rows == 900


def test_readings_stay_the_same_while_they_are_gathered_and_thinned(stored: Path) -> None:
    counts = list[tuple[int, int]]()
    with closing(connect(stored)) as connection:
        pruning = Pruning(Retention(samples_days=1.0), 0.0)
        for hours in range(2, 60, 6):  # each mark, a day later, deletes what was there
            if hours < 20:
                with Store(stored, f"after {hours} h", SteppedClock()) as store:
                    store.record(ReadingsTaken(readings(50_000.0 + 1000.0 * hours, 50_300.0 + 1000.0 * hours)))
            pruning.prune(connection, hours * 3600.0)
            connection.commit()
            assert in_blocks(stored, *ALWAYS) == in_rows(stored, *ALWAYS)
            counts += connection.execute(
                "SELECT count(*), (SELECT coalesce(sum(rows), 0) FROM reading_block) FROM reading"
            )
    assert counts[-1] == (1, 1), "a block remains no longer than its readings"
    assert all(in_them <= there for there, in_them in counts)
    assert max(in_them for _, in_them in counts) > 3000


def test_a_damaged_block_is_replaced_by_its_rows_where_a_part_of_it_is_wanted(stored: Path) -> None:
    whole = in_rows(stored, *ALWAYS, ("a",))
    with closing(sqlite3.connect(stored)) as connection:
        connection.execute("UPDATE reading_block SET value = substr(value, 1, 100)")
        connection.commit()
    assert in_blocks(stored, *ALWAYS, ("a",), 100) == whole


def test_a_database_of_an_earlier_program_is_packed_as_it_is_read(stored: Path) -> None:
    whole = in_rows(stored, *ALWAYS)
    with closing(sqlite3.connect(stored)) as connection:
        connection.execute("DROP TABLE reading_block")
    assert in_blocks(stored, *ALWAYS, None, 1000) == whole


def test_an_invalid_block_is_refused_and_its_wrong_column_named(stored: Path) -> None:
    block = blocks_page(stored, *ALWAYS, None, 50_000).blocks[0]
    longer = pack(np.ones(2000, [("channel", "i8"), ("time", "f8"), ("value", "f8"), ("quality", "i8")]))
    for spoilt, said in (
        (block._replace(value=b"\x78\x01nothing"), "value: Error"),
        (block._replace(time=block.time[:-9]), "time: expected 1800 numbers"),
        (block._replace(quality=longer.quality), "quality: expected 1800 numbers"),
        (block._replace(channel=b""), "channel: expected 1800 numbers"),
        (block._replace(rows=1799), "time: expected 1799 numbers"),
        (ReadingBlock(1, 0.0, 0.0, longer.time, b"", b"", b""), "time: expected 1 numbers"),
    ):
        with pytest.raises(DamagedBlock, match=said):
            unpack(spoilt)
