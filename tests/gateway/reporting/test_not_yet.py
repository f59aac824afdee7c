"""A gateway that has not learnt yet gets a page that says what is missing."""

import html
import sys
from collections.abc import Mapping
from pathlib import Path
from zoneinfo import ZoneInfo

import numpy as np
import pytest
from click.testing import CliRunner

from drivers.base import Quality
from gateway.cli.main import main
from gateway.config.model import GatewayConfig
from gateway.control.restart.earlier import earlier_run
from gateway.model.events import MeasurementEnded, ReadingsTaken
from gateway.model.probing import End, Outcome
from gateway.model.sample import Sample
from gateway.model.text import plain
from gateway.service.report_data import own_zone
from gateway.storage.store import Store
from talc.frame import Frame, Why
from tests.benches.service_file import two_temperatures
from tests.benches.stepped_clock import EPOCH, SteppedClock
from tests.benches.stored_steps import record_step

NC = {"kind": "sinumerik", "url": "opc.tcp://192.168.214.1:4840", "security": "none"}
REFUSED = "a touch repeats by 14 µm"


def page_of(path: Path, config: GatewayConfig, steps: int, refused: bool = False) -> str:
    """The report of a gateway of which only `bed` has ever been read."""
    with Store(path, "first", SteppedClock()) as store:
        store.begin(config.canonical(), config.fingerprint(), "")
        controller = earlier_run(store, config).controller
        store.record(ReadingsTaken([Sample("bed", 20.0, "degC", Quality.GOOD, EPOCH, 0.0, sequence=1)]))
        if refused:
            store.record(
                MeasurementEnded(
                    Outcome(
                        1,
                        Why.CALIBRATION,
                        EPOCH,
                        EPOCH,
                        None,
                        (0.0, 0.0, 0.0),
                        None,
                        float("nan"),
                        plain(REFUSED),
                        End.REJECTED,
                    )
                )
            )
        for k in range(steps):
            frame = Frame(k, np.array([20.0, np.nan]), np.array([True, False]), None)
            record_step(store, controller, frame)
    return reported(path)


def reported(path: Path) -> str:
    answer = CliRunner().invoke(main, ["report", str(path), "--time-zone", "Europe/Zurich"], catch_exceptions=False)
    assert answer.exit_code == 0, answer.output
    return html.unescape(path.with_suffix(".html").read_text(encoding="utf-8"))


@pytest.mark.parametrize(
    ("more", "steps", "refused", "said"),
    [
        ({}, 0, False, ("No grid step has ended", "No good reading of column", "No control is configured")),
        ({"nc": NC}, 0, False, ("No grid step has ended", "Probing is not armed", "No measurement yet")),
        ({"nc": NC}, 3, False, ("Probing is not armed", "No measurement yet", "No reference")),
        ({"nc": NC, "probing": {"armed": True}}, 3, False, ("No measurement yet", "No reference")),
        ({"nc": NC, "probing": {"armed": True}}, 3, True, ("None of 1 probing cycles was used", REFUSED)),
    ],
)
def test_what_is_missing_is_said(
    more: Mapping[str, Mapping[str, object]], steps: int, refused: bool, said: tuple[str, ...], tmp_path: Path
) -> None:
    path = tmp_path / "g.sqlite"
    page = page_of(path, two_temperatures(path, more), steps, refused)
    assert [text for text in said if text not in page] == []
    assert ("Probing is not armed" in page) == ("Probing is not armed" in said)
    assert ("No grid step has ended" in page) == (steps == 0)
    assert "mill" in page
    assert ('column</th><td class="l">never read</td>' in page) == (steps > 0)
    assert "Readings by quality; 1 other channel gave good readings only" in page or not steps


def test_what_has_not_been_measured_has_no_chart_and_no_figures(tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    page = page_of(path, two_temperatures(path, {"nc": NC, "probing": {"armed": True}}), 3, refused=True)
    assert "temperatures, °C" in page
    assert "Each error" not in page
    assert "EY0A" not in page
    assert "the figures say" not in page
    assert "1 cycle of 2 min" in page
    assert "0 state updates, 1 cycle rejected." in page


def test_a_database_without_a_run_says_how_to_begin_one(tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    with Store(path, "first", SteppedClock()):
        pass
    assert "talc-gateway run CONFIG" in reported(path)


@pytest.mark.parametrize("shifts", ["25:00", "6", "06:00,x"])
def test_a_shift_that_is_no_time_of_day_is_refused(shifts: str, tmp_path: Path) -> None:
    (tmp_path / "g.sqlite").touch()
    answer = CliRunner().invoke(main, ["report", str(tmp_path / "g.sqlite"), "--shifts", shifts])
    assert (answer.exit_code, "expected times of day such as 06:00" in answer.output) == (2, True)


def test_the_computers_own_zone_knows_daylight_saving(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    link = tmp_path / "localtime"
    link.symlink_to("/usr/share/zoneinfo/Europe/Zurich")
    monkeypatch.delenv("TZ", raising=False)
    assert own_zone(link) == ZoneInfo("Europe/Zurich")
    monkeypatch.setenv("TZ", ":America/New_York")
    assert own_zone(link) == ZoneInfo("America/New_York")
    monkeypatch.setenv("TZ", "CET-1CEST")
    assert own_zone(link) == ZoneInfo("Europe/Zurich")
    assert str(own_zone(tmp_path / "none")) == "UTC"


@pytest.mark.parametrize("command", ["report", "replay", "demo"])
def test_an_installation_without_the_page_maker_says_what_to_install(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "g.sqlite"
    file.touch()
    monkeypatch.setattr(
        sys.modules["gateway.runtime.extras"],
        "find_spec",
        lambda name: None if name == "matplotlib" else object(),
    )
    answer = CliRunner().invoke(main, [command] if command == "demo" else [command, str(file)])
    assert (answer.exit_code, "matplotlib not installed; pip install" in answer.output) == (2, True)
