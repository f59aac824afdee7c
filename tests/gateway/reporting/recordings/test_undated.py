"""A recording that counts seconds without a date gets no invented date in the page, the terminal or the table."""

import csv
import html
import json
import re
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import pyarrow
import pyarrow.parquet
import pytest

from gateway.reporting.recordings.columns import Columns
from gateway.reporting.recordings.grid import read_recording
from gateway.reporting.recordings.times import TimeFormat
from tests.benches.command import Done, here

EPOCH = 1_772_431_200  # 2026-03-02 06:00 UTC


def table(folder: Path, time: Callable[[int], object], rows: int = 60) -> Path:
    path = folder / "own.csv"
    lines = (f"{time(i)},{20 + i % 7 * 0.3:.1f},{i % 5}" for i in range(rows))
    path.write_text("\n".join(["time,t1,EX0C", *lines]), encoding="utf-8")
    return path


def run(path: Path, *arguments: object) -> Done:
    answer = here("replay", path, *arguments)
    assert answer.code == 0, answer.together
    return answer


def test_hours_are_counted_from_the_first_row(tmp_path: Path) -> None:
    path, out = table(tmp_path, lambda i: 900 + 300 * i), tmp_path / "steps.csv"
    answer = run(path, "--out", out)
    assert "times: seconds without a date; the report counts hours from the first row, 900 s\n" in answer.together
    page = html.unescape(path.with_suffix(".html").read_text("utf-8"))
    assert "own, 0:00 h to 4:55 h (5.0 h)" in page
    assert "Times are hours and minutes from the recording's first row: it counts seconds without a date." in page
    body = page[page.index("<body>") : page.index('<script type="application/json"')]
    assert not re.search(r"\b19[67]\d\b|\bUTC\b|\bJan\b", body)
    still = re.findall(r'<div class="still">(<svg.*?</svg>)', page, re.DOTALL)[0]
    assert "<!-- 2 h -->" in still or ">2 h<" in still
    series = json.loads(page[page.index('id="series">') + 12 :].split("</script>", 1)[0])
    assert (series["start"], series["dated"]) == (0.0, False)
    with out.open(encoding="utf-8", newline="") as file:
        assert [float(row["time"]) for row in csv.DictReader(file)][:3] == [900.0, 1200.0, 1500.0]


@pytest.mark.parametrize(
    ("time", "clock", "origin"),
    [
        (lambda i: 300 * i, TimeFormat(), 0.0),
        (lambda i: 300 * i - 1000, TimeFormat(), -1000.0),
        (lambda i: 7 + 20 * i, TimeFormat(), 7.0),
        (lambda i: EPOCH + 300 * i, TimeFormat(), None),
        (lambda i: datetime.fromtimestamp(300 * i, UTC).isoformat(), TimeFormat(), None),
        (lambda i: 27000 + i / 288, TimeFormat("excel"), None),
        (lambda i: 300 * i if i < 2 else EPOCH + 300 * i, TimeFormat(), None),
    ],
)
def test_what_counts_as_a_date(
    tmp_path: Path, time: Callable[[int], object], clock: TimeFormat, origin: float | None
) -> None:
    """The last case: a logger's clock was set after two rows."""
    path = table(tmp_path, time, rows=400)
    assert read_recording(path, Columns(clock=clock), 300.0).origin_s == origin


def test_times_of_parquet_in_1970_are_seconds_that_a_program_took_for_dates(tmp_path: Path) -> None:
    rows, path = range(60), tmp_path / "own.parquet"
    time = pyarrow.array([300 * i for i in rows], pyarrow.timestamp("s"))
    columns = {"time": time, "t1": [20 + i % 7 * 0.3 for i in rows], "EX0C": [float(i % 5) for i in rows]}
    pyarrow.parquet.write_table(pyarrow.table(columns), path)
    assert read_recording(path, Columns(), 300.0).origin_s == 0.0
