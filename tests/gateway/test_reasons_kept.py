"""The learner's reasons are stored, compared by a replay, and shown in the report."""

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from gateway.cli.main import main
from gateway.config.file import parse
from gateway.config.model import GatewayConfig
from gateway.control.replay.stored import replay
from gateway.model.events import DecisionMade, FrameMade, ReasonsGiven
from gateway.storage.history import History
from gateway.storage.readings import Retention
from gateway.storage.store import Store
from talc.control import Controller
from talc.explanation import Reasons
from talc.frame import Frame, Measurement
from tests.benches.service_file import MACHINE, adam6015
from tests.benches.stepped_clock import SteppedClock
from tests.benches.thermal_series import series

TEXT = f"""{MACHINE}
[storage]
path = "gateway.sqlite"
""" + adam6015(", ".join(f"t{i} = {i}" for i in range(6)))
STEPS = 120


@pytest.fixture
def config(tmp_path: Path) -> GatewayConfig:
    return parse(TEXT, tmp_path / "gateway.toml")


@pytest.fixture
def given(config: GatewayConfig) -> Reasons:
    """The last reasons of a stored run of ten hours, in which EC0C stays zero."""
    made, controller = series(STEPS, 5), Controller(config.input_names, config.talc)
    measured = made.measured - made.truth[0]
    measured[:, 8] -= (made.truth - made.truth[0])[:, 8]
    with Store(config.storage.path, "boot", SteppedClock()) as store:
        store.begin(config.canonical(), config.fingerprint(), "")
        for k in range(STEPS):
            measurement = Measurement(measured[k], np.full(9, 0.5)) if k % 10 == 0 else None
            frame = Frame(k, made.inputs[k, :6], np.ones(6, dtype=np.bool_), measurement)
            store.record(FrameMade(frame))
            store.record(DecisionMade(controller.step(frame)))
            if measurement is not None and (reasons := controller.reasons()) is not None:
                store.record(ReasonsGiven(reasons))
    return reasons if reasons is not None else pytest.fail("no reasons")


@pytest.fixture
def history(config: GatewayConfig, given: Reasons) -> Iterator[History]:
    with History(config.storage.path) as found:
        yield found


def test_the_latest_reasons_come_back_as_they_were(history: History, given: Reasons) -> None:
    assert history.reasons() == given


def test_which_errors_were_corrected_comes_back_and_is_compared(config: GatewayConfig, history: History) -> None:
    trusted = np.array([s.decision.trusted for s in history.steps()])
    assert trusted[-1, :8].all()
    assert not trusted[-1, 8]
    assert replay(history).identical
    with closing(sqlite3.connect(config.storage.path)) as connection, connection:
        connection.execute("UPDATE trust SET trusted = ? WHERE k = 50", (np.packbits(~trusted[50]).tobytes(),))
    result = replay(history)
    assert (result.differences, result.first is not None and result.first.k) == (1, 50)
    assert result.first is not None
    assert result.first.what.startswith("trusted: ")


def test_a_database_of_an_earlier_program_has_neither_and_is_replayed(config: GatewayConfig, given: Reasons) -> None:
    with closing(sqlite3.connect(config.storage.path)) as connection, connection:
        connection.execute("DROP TABLE trust")
        connection.execute("DROP TABLE reasons")
    with History(config.storage.path) as history:
        assert history.reasons() is None
        assert not next(history.steps()).trust_known
        assert replay(history).identical
    with Store(config.storage.path, "later", SteppedClock()) as store:
        store.record(ReasonsGiven(replace(given, k=STEPS)))
    with History(config.storage.path) as history:
        assert history.reasons() == replace(given, k=STEPS)


def test_old_reasons_are_deleted_with_the_readings(config: GatewayConfig, given: Reasons) -> None:
    for boot in ("later", "latest"):
        clock = SteppedClock()
        with Store(config.storage.path, boot, clock, retention=Retention(samples_days=7.0)) as store:
            store.record(ReasonsGiven(replace(given, k=STEPS)))
            store.flush()
            clock.spend(8 * 86400.0)
    with Store(config.storage.path, "last", clock):
        pass
    with closing(sqlite3.connect(config.storage.path)) as connection:
        kept = connection.execute("SELECT k FROM reasons").fetchall()
    assert kept == [(STEPS,)]


@pytest.mark.slow
def test_the_report_says_what_moves_each_error_and_which_is_not_corrected(
    config: GatewayConfig, given: Reasons
) -> None:
    page = config.storage.path.with_suffix(".html")
    answer = CliRunner().invoke(main, ["report", str(config.storage.path)], catch_exceptions=False)
    assert answer.exit_code == 0, answer.output
    why = page.read_text(encoding="utf-8").split("<h2>Why</h2>")[1].split("<h2>")[0]
    assert why.count("no: the estimate is no better than no correction") == 1
    name, value = given.errors[0].inputs[0]
    assert f"{name} {value:+.1f}" in why
    assert f"{given.errors[0].expected:+.1f} ± {given.errors[0].expected_sigma:.1f}" in why
