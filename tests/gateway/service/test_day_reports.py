"""Reports of single days: made in a separate process, kept when the day is over, ended with the gateway."""

import asyncio
import gzip
import threading
from datetime import UTC, date, datetime, timedelta
from pathlib import Path

import pytest

from gateway.runtime.workers.process import WorkError
from gateway.service.day_reports import DayReports
from gateway.telemetry.report_queries import ReportRequest
from tests.benches.stored_days import DAY, two_days

NOON = datetime(2026, 3, 3, 12, tzinfo=UTC)
ASKED = ReportRequest(date(2026, 3, 2), "Europe/Zurich")


class Made:
    """Counts what was made, at a time that the test sets."""

    def __init__(self, now: datetime) -> None:
        self.now, self.elapsed_s, self.count = now, 0.0, 0
        self.reports = DayReports(Path("g.sqlite"), lambda: self.now, self.make, lambda: self.elapsed_s)

    async def make(self, database: Path, asked: ReportRequest) -> bytes:
        self.count += 1
        return f"{database} {asked.day} {asked.zone} {self.count}".encode()


def test_a_day_that_is_over_is_made_once_for_each_zone() -> None:
    made = Made(NOON)
    first = made.reports(ASKED)
    assert (first.day, first.zone, first.page) == (
        "2026-03-02",
        "Europe/Zurich",
        b"g.sqlite 2026-03-02 Europe/Zurich 1",
    )
    made.elapsed_s = 1e6
    assert made.reports(ASKED) == first
    assert made.reports(ReportRequest(ASKED.day, "")).page.endswith(b" 2")


@pytest.mark.parametrize(
    ("now", "zone", "over"),
    [
        (datetime(2026, 3, 2, 23, 29, tzinfo=UTC), "Europe/Zurich", False),
        (datetime(2026, 3, 2, 23, 31, tzinfo=UTC), "Europe/Zurich", True),
        (datetime(2026, 3, 3, 23, 59, tzinfo=UTC), "", False),  # its zone is not known here
        (datetime(2026, 3, 4, 0, 31, tzinfo=UTC), "", True),
    ],
)
def test_a_day_that_is_not_over_and_stored_is_made_again_after_a_minute(now: datetime, zone: str, over: bool) -> None:
    made, asked = Made(now), ReportRequest(ASKED.day, zone)
    made.reports(asked)
    made.elapsed_s = 59.0
    made.reports(asked)
    assert made.count == 1
    made.elapsed_s = 61.0
    made.reports(asked)
    assert made.count == (1 if over else 2)


def test_only_the_latest_are_kept() -> None:
    made = Made(NOON)
    days = [ReportRequest(ASKED.day - timedelta(days=n), "UTC") for n in range(9)]
    for asked in days:
        made.reports(asked)
    made.reports(days[-1])
    assert made.count == 9
    made.reports(days[0])
    assert made.count == 10


def test_an_unknown_zone_is_a_wrong_request_and_nothing_is_made() -> None:
    made = Made(NOON)
    for zone in ("Mars/Base", "../../etc/passwd", "/etc/passwd"):
        with pytest.raises(ValueError, match="unknown on the gateway's computer; expected one like Europe/Zurich"):
            made.reports(ReportRequest(ASKED.day, zone))
    assert made.count == 0


def test_what_went_wrong_is_said() -> None:
    async def fail(*_: object) -> bytes:
        raise WorkError("MemoryError (exit status 1)")

    reports = DayReports(Path("g.sqlite"), lambda: NOON, fail)
    with pytest.raises(OSError, match=r"2026-03-02.*MemoryError"):
        reports(ASKED)


def test_closing_ends_what_is_being_made_and_what_comes_later() -> None:
    begun, said = threading.Event(), list[str]()

    async def forever(*_: object) -> bytes:
        begun.set()
        await asyncio.Event().wait()
        raise AssertionError

    reports = DayReports(Path("g.sqlite"), lambda: NOON, forever)

    def ask() -> None:
        with pytest.raises(OSError, match="the gateway is stopping") as refused:
            reports(ASKED)
        said.append(str(refused.value))

    thread = threading.Thread(target=ask)
    thread.start()
    assert begun.wait(60.0)
    reports.close()
    thread.join(60.0)
    ask()
    assert len(said) == 2


@pytest.mark.slow
def test_a_separate_process_makes_the_page(tmp_path: Path) -> None:
    reports = DayReports(two_days(tmp_path / "g.sqlite"), lambda: NOON, limit_s=3600.0)
    page = gzip.decompress(reports(ReportRequest(DAY, "Europe/Zurich", tolerance_um=7.25)).page).decode()
    assert "7.25" in page
    assert "Mon 2026-03-02 00:55 CET to Tue 2026-03-03 00:00 CET" in page, "the first step of that day, and the last"
    nothing = gzip.decompress(reports(ReportRequest(date(2026, 3, 9), "Europe/Zurich")).page).decode()
    assert "Nothing is stored of Mon 2026-03-09" in nothing
