"""Every sentence is reworded, and nothing but what people read changes."""

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from drivers import text as sentences
from gateway.cli.main import main
from gateway.config.file import load
from gateway.config.problems import ConfigError
from gateway.control.restart.proven import proven_in
from gateway.control.trainer import models_of_failure
from gateway.listeners.collect.collector import Collector
from gateway.model import text as wording
from gateway.model.codes import NoticeCode
from gateway.model.events import EventReported
from gateway.model.notice import Notice
from gateway.model.probing import Outlook
from gateway.model.standing import Standing
from gateway.model.text import NOTHING, Text
from gateway.model.wording import event_of, problem_event
from gateway.nc.probing.geometry import geometry_of, recorded
from gateway.nc.probing.schedule import Bulletin
from gateway.nc.problems import still_wrong
from gateway.runtime.problems import Problems, TurnTime
from gateway.storage.history import History
from gateway.storage.store import Store
from gateway.telemetry.answers import QueryRefused
from gateway.telemetry.asking import QueryRefusal
from gateway.telemetry.codec import decode_refusal, encode
from gateway.telemetry.fields import coded
from talc.frame import EventKind, Why
from talc.models import ModelSet
from tests.benches.refusals import coded as in_codes
from tests.benches.stepped_clock import SteppedClock
from tests.benches.telemetry_examples import configuration
from tests.gateway.config.test_config import mistaken
from tests.gateway.control.test_trainer import JOB

PLAIN = sentences.texts


def reworded(language: str) -> Mapping[str, str]:
    """Every sentence with its words reversed, and something that no sentence begins or ends with."""
    return {
        key: f"~ {' '.join(reversed(text.split(' ')))} ~" if key.startswith("text.") else text
        for key, text in PLAIN(language).items()
    }


def notices() -> list[Notice]:
    """What one run reports."""
    time, told = TurnTime(), list[Notice]()
    problems = Problems(time, 1.0, told.append, logging.getLogger(__name__), most=1)
    for turn in range(3):
        time.now_s = float(turn)
        problems.report("line of bus rtu1", Text(NoticeCode.OTHER_MASTER, bus="rtu1", evidence="3 frames"))
        problems.report("NC", Text(NoticeCode.NC_NOT_CONNECTED, error="silent"), "line")
        problems.clear("NC", NoticeCode.NC_CONNECTED_AGAIN)
    problems.report("watchdog of NC", Text(NoticeCode.NC_WATCHDOG_SILENT))
    return told


def kept(path: Path) -> None:
    """Store what a run reports, and a dry run."""
    config = configuration("mill")
    geometry = geometry_of(config)
    with Store(path, path.stem, SteppedClock()) as store:
        store.begin(config.canonical(), config.fingerprint(), "", None)
        for notice in notices():
            store.record(EventReported(problem_event(notice), None))
        if geometry is not None:
            store.record(EventReported(event_of(EventKind.OPERATOR, recorded(geometry, "6 poses")), None))
        store.flush()


def decided(path: Path) -> tuple[Any, ...]:
    """What programs find out from a store, and from what others say."""
    config = configuration("mill")
    with History(path) as history:
        events = [(e.kind, e.code, dict(e.values).get("subject")) for _, _, e in history.events()]
        wrong = [text.code for text in still_wrong(wording.plain(e.text) for _, e in history.troubles())]
        proven = proven_in(history, config)
    failed = models_of_failure(JOB, OSError("killed"))
    blocked = Text(NoticeCode.NC_ALARM, numbers=("21612",))
    bulletin, outlooks = Bulletin(), []
    for standing, reason in ((Standing.BLOCKED, blocked), (Standing.BLOCKED, blocked), (Standing.WAITING, NOTHING)):
        outlooks += [(e.kind, e.code) for e in bulletin.of(Outlook(standing, Why.INTERVAL, reason))]
    refused = Text(NoticeCode.NO_SUCH_TABLE, table="reasons", tables=("steps", "events"))
    heard = decode_refusal(encode(QueryRefused(f"stored: {refused}", coded(refused))))
    return events, wrong, proven, ModelSet.from_dict(failed.to_dict()).failed, outlooks, lacking(heard)


def lacking(refused: Text) -> frozenset[str]:
    """The tables that a collector no longer asks for."""

    class Earlier:
        def running(self) -> list[str]:
            return ["mill"]

        def ask(self, machine: str, after: Mapping[str, object], limit: int) -> object:
            raise QueryRefusal(refused)

    collector = Collector(Earlier(), None)  # type: ignore[arg-type]
    return collector._lacking("mill", dict.fromkeys(("steps", "events", "reasons")), refused)  # noqa: SLF001


BROKEN = "unit_out_of_range", "linuxcnc_other_poses", "not_toml", "wrong_value", "bound_too_large"
"""Of the cases of broken configurations: each mistake is in a driver, in a section, between sections or no TOML."""


def mistakes(folder: Path) -> list[tuple[object, ...]]:
    """What programs know of the mistakes in files."""
    found = list[tuple[object, ...]]()
    for case in BROKEN:
        with pytest.raises(ConfigError) as raised:
            load(mistaken(case, folder))
        found += [(case, problem.place, problem.at, in_codes(problem.what)) for problem in raised.value.problems]
    return found


def test_reworded_refusals_name_the_same_fields_and_values(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = mistakes(tmp_path)
    german = Text("unit_beyond", unit=248, low=1, high=247, kind="modbus_rtu").in_language("de")
    file = str(mistaken("unit_out_of_range", tmp_path))
    done = CliRunner().invoke(main, ["check", file], env={"LC_ALL": "de_DE.UTF-8"})
    assert (done.exit_code, german in done.output) == (2, True), done.output
    monkeypatch.setattr(sentences, "texts", reworded)
    assert mistakes(tmp_path) == before


def test_reworded_messages_change_nothing_but_what_people_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept(tmp_path / "plain.sqlite")
    before, said = decided(tmp_path / "plain.sqlite"), str(Text(NoticeCode.NC_CONNECTED_AGAIN))
    monkeypatch.setattr(sentences, "texts", reworded)
    kept(tmp_path / "reworded.sqlite")
    assert str(Text(NoticeCode.NC_CONNECTED_AGAIN)) != said
    assert decided(tmp_path / "reworded.sqlite") == before
    assert decided(tmp_path / "plain.sqlite") == before, "stored by a program with other words"


def test_the_plain_wording_finds_what_there_is(tmp_path: Path) -> None:
    kept(tmp_path / "plain.sqlite")
    events, wrong = decided(tmp_path / "plain.sqlite")[:2]
    assert NoticeCode.NC_WATCHDOG_SILENT in wrong
    assert {subject for _, _, subject in events} >= {"NC", "line of bus rtu1", "watchdog of NC"}
