"""The report of a single local day."""

import html
from datetime import UTC, date, datetime
from pathlib import Path
from zoneinfo import ZoneInfo

import numpy as np
from click.testing import CliRunner

from gateway.cli.main import main
from gateway.service.report_data import Reader, collect, empty_page
from tests.benches.stored_days import DAY, STEP_S, two_days

ZURICH = ZoneInfo("Europe/Zurich")


def test_a_day_is_from_local_midnight_to_local_midnight(tmp_path: Path) -> None:
    whole = collect(path := two_days(tmp_path / "g.sqlite"), reader=Reader(ZURICH))
    data = collect(path, reader=Reader(ZURICH, day=DAY))
    times = [datetime.fromtimestamp(k * STEP_S, ZURICH) for k in data.k.tolist()]
    assert (len(whole.k), len(data.k)) == (30, 24)
    # A step is of the time before its instant: the one at midnight is the day's that ends then.
    assert (times[0], times[-1]) == (datetime(2026, 3, 2, 1, tzinfo=ZURICH), datetime(2026, 3, 3, tzinfo=ZURICH))
    assert data.cycles == 4, "at 5, 11, 17 and 23 o'clock"
    assert data.compensation_um[:, 2].tolist() == [6.0, 12.0, 18.0, 24.0]
    assert np.flatnonzero(np.isfinite(data.measured[:, 0])).tolist() == [4, 10, 16, 22]
    assert data.channel_health["column"] == {"good": 23, "not_good": 1}
    assert data.channel_health["bed"] == {"good": 24}


def test_the_reference_counts_as_many_cycles_only_on_its_own_day(tmp_path: Path) -> None:
    path = two_days(tmp_path / "g.sqlite")
    reference, later = (collect(path, reader=Reader(UTC, day=date(2026, 3, d))).cycles_seen for d in (1, 2))
    assert [cycle.cycles for cycle in later] == [1, 1, 1, 1]
    assert reference[0].cycles > 1


def test_a_day_on_which_the_clocks_change_has_23_hours(tmp_path: Path) -> None:
    path = two_days(tmp_path / "g.sqlite", datetime(2026, 3, 28, 20, tzinfo=UTC))
    data = collect(path, reader=Reader(ZURICH, day=date(2026, 3, 29)))
    assert len(data.k) == 23


def test_a_day_without_a_step_says_which_days_there_are(tmp_path: Path) -> None:
    path = two_days(tmp_path / "g.sqlite")
    assert empty_page(path, Reader(ZURICH, day=DAY)) is None
    for day in (date(2026, 2, 27), date(2026, 3, 4)):
        page = html.unescape(empty_page(path, Reader(ZURICH, day=day)) or "")
        assert f"Nothing is stored of {day:%a %Y-%m-%d}" in page
        assert "Sun 2026-03-01 23:00 CET" in page
        assert "Tue 2026-03-03 04:00 CET" in page


def test_the_command_writes_the_page_of_a_day(tmp_path: Path) -> None:
    path = two_days(tmp_path / "g.sqlite")
    arguments = ["report", str(path), "--time-zone", "Europe/Zurich", "--day"]
    answer = CliRunner().invoke(main, [*arguments, "2026-03-09"], catch_exceptions=False)
    assert (answer.exit_code, answer.output.splitlines()[0]) == (0, "nothing is stored for 2026-03-09")
    paper = path.with_suffix(".pdf")
    CliRunner().invoke(main, [*arguments, str(DAY), "--pdf"], catch_exceptions=False)
    assert paper.read_bytes().startswith(b"%PDF-")
    wrong = CliRunner().invoke(main, [*arguments, "yesterday"])
    assert wrong.exit_code == 2
    assert "--day" in wrong.output
