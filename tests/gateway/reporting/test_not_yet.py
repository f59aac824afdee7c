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
from gateway.model.text import Language, plain
from gateway.reporting.figures import summary
from gateway.service.report_data import collect, not_yet, own_zone
from gateway.storage.history import History
from gateway.storage.store import Store
from talc.frame import Frame, Why
from tests.benches.service_file import two_temperatures
from tests.benches.stepped_clock import EPOCH, SteppedClock
from tests.benches.stored_steps import record_step

NC = {"kind": "sinumerik", "url": "opc.tcp://192.168.214.1:4840", "security": "none"}


REFUSED = "a touch repeats by 14 µm"


def store_of(path: Path, config: GatewayConfig, steps: int, *, refused: bool) -> None:
    """The database of a gateway of which only `bed` has ever been read."""
    nothing = (0.0, 0.0, 0.0)
    ended = Outcome(1, Why.CALIBRATION, EPOCH, EPOCH, None, nothing, None, float("nan"), plain(REFUSED), End.REJECTED)
    with Store(path, "first", SteppedClock()) as store:
        store.begin(config.canonical(), config.fingerprint(), "")
        controller = earlier_run(store, config).controller
        store.record(ReadingsTaken([Sample("bed", 20.0, "degC", Quality.GOOD, EPOCH, 0.0, sequence=1)]))
        if refused:
            store.record(MeasurementEnded(ended))
        for k in range(steps):
            record_step(store, controller, Frame(k, np.array([20.0, np.nan]), np.array([True, False]), None))


def reported(path: Path) -> str:
    answer = CliRunner().invoke(main, ["report", str(path), "--time-zone", "Europe/Zurich"], catch_exceptions=False)
    assert answer.exit_code == 0, answer.output
    return html.unescape(path.with_suffix(".html").read_text(encoding="utf-8"))


@pytest.mark.parametrize(
    ("more", "steps", "refused", "missing"),
    [
        ({}, 0, False, ["step", "reading", "control", "measurement", "reference"]),
        ({"nc": NC}, 0, False, ["step", "reading", "probing", "measurement", "reference"]),
        ({"nc": NC}, 3, False, ["reading", "probing", "measurement", "reference"]),
        ({"nc": NC, "probing": {"armed": True}}, 3, False, ["reading", "measurement", "reference"]),
        ({"nc": NC, "probing": {"armed": True}}, 3, True, ["reading", "used", "reference"]),
    ],
)
def test_what_is_missing_is_on_the_page_in_the_order_in_which_it_comes(
    more: Mapping[str, Mapping[str, object]], steps: int, refused: bool, missing: list[str], tmp_path: Path
) -> None:
    path = tmp_path / "g.sqlite"
    config = two_temperatures(path, more)
    store_of(path, config, steps, refused=refused)
    with History(path) as history:
        found = not_yet(history, config, list(history.steps(-1)), history.channel_health())
    assert [each.key for each in found] == missing
    values = {key: each.values[key] for each in found for key in each.values}
    assert values["channels"] == ["column"]
    assert not refused or (values["n"], values["last"]) == (config.probing.reference_cycles, REFUSED)
    page = " ".join(reported(path).split())
    places = [page.index(part) for each in found for part in each.written(Language("en"))]
    assert places == sorted(places)


def test_what_has_not_been_measured_has_no_figures(tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    store_of(path, two_temperatures(path, {"nc": NC, "probing": {"armed": True}}), 3, refused=True)
    found = collect(path)
    assert (found.cycles, found.rejected_cycles, summary(found).basis) == (1, 1, "nothing")
    assert "EY0A" not in reported(path)


def test_a_database_without_a_run_has_a_page(tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    with Store(path, "first", SteppedClock()):
        pass
    assert "g.sqlite" in reported(path)


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
def test_an_installation_without_the_page_maker_names_it(
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
    assert (answer.exit_code, "matplotlib" in answer.output) == (2, True), answer.output
