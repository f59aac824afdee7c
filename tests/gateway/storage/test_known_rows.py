"""What was acted upon is committed at once, and what the running gateway knows survives the loss of its database."""

import sqlite3
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.base import DriverError
from gateway.config.applied import ConfigurationApplied
from gateway.model.commands import Command, CommandName, CommandOutcome
from gateway.model.events import (
    CommandGiven,
    DecisionMade,
    FrameMade,
    GatewayEvent,
    MeasurementEnded,
    ModelsAdopted,
    ProbingRequested,
)
from gateway.model.text import plain
from gateway.storage.history import History
from gateway.storage.store import Store
from tests.benches import telemetry_examples as example
from tests.benches.stepped_clock import SteppedClock
from tests.benches.store_writer import step
from tests.benches.waits import wait_until

LONG_S = 3600.0


def given(name: CommandName, by: str, *, accepted: bool = True) -> CommandGiven:
    return CommandGiven(CommandOutcome(Command(name, by), example.NOW, accepted, plain("text")))


def count(path: Path, table: str) -> int:
    with closing(sqlite3.connect(path, timeout=60.0)) as connection:
        found: int = connection.execute(f"SELECT count(*) FROM {table}").fetchone()[0]
        return found


@pytest.mark.parametrize(
    ("table", "event"),
    [
        ("running", ConfigurationApplied(example.configuration("mill"))),
        ("decision", DecisionMade(example.DECISION)),
        ("request", ProbingRequested(5)),
        ("measurement", MeasurementEnded(example.OUTCOME)),
        ("model", ModelsAdopted(example.MODELS, 7)),
        ("command", given(CommandName.PAUSE, "anna")),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_what_was_acted_upon_is_committed_at_once(table: str, event: GatewayEvent, tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    with Store(path, "boot1", SteppedClock(), commit_s=LONG_S) as store:
        store.begin("{}", "hash", "versions", ("prior's hash", "prior's text"))
        wait_until(lambda: count(path, "boot") == 1)
        store.record(event)
        wait_until(lambda: count(path, table) == 1)
    with closing(sqlite3.connect(path)) as connection:
        assert connection.execute("SELECT * FROM prior").fetchall() == [("prior's hash", "prior's text")]
        assert connection.execute("SELECT * FROM prior_of_boot").fetchall() == [(1, "prior's hash")]


def after_a_deletion(path: Path, events: Sequence[GatewayEvent]) -> None:
    """Delete the file after these events, while the gateway runs."""
    with Store(path, "boot1", SteppedClock(), commit_s=0.01, retry_s=0.05, look_s=0.02) as store:
        store.begin("{}", "hash", "versions")
        for event in events:
            store.record(event)
        store.flush()
        path.unlink()
        wait_until(lambda: store.health.mended)


@pytest.mark.parametrize(
    ("commands", "standing"),
    [
        ([given(CommandName.PAUSE, "anna"), given(CommandName.PAUSE, "berta")], [("pause", "anna")]),
        ([given(CommandName.PAUSE, "anna", accepted=False)], []),
        ([given(CommandName.PAUSE, "anna"), given(CommandName.RESUME, "berta")], []),
        ([given(CommandName.PAUSE, "anna"), given(CommandName.RESUME, "berta", accepted=False)], [("pause", "anna")]),
        ([given(CommandName.DISARM, "anna"), given(CommandName.RESUME, "berta")], [("disarm", "anna")]),
        ([given(CommandName.RESUME, "berta"), given(CommandName.MEASURE, "anna")], []),
    ],
)
def test_a_command_that_stands_is_in_the_new_database(
    commands: Sequence[CommandGiven], standing: list[tuple[str, str]], tmp_path: Path
) -> None:
    path = tmp_path / "g.sqlite"
    after_a_deletion(path, commands)
    with closing(sqlite3.connect(path)) as connection:
        assert connection.execute("SELECT name, by FROM command").fetchall() == standing


def test_the_first_measurement_that_was_used_stays_the_reference(tmp_path: Path) -> None:
    path, centres = tmp_path / "g.sqlite", np.zeros((6, 3))
    refused = replace(example.REFUSED, centres_mm=centres)
    later = replace(example.OUTCOME, number=77)
    outcomes = [refused, example.PER_POSE, example.OUTCOME, later, refused]
    after_a_deletion(path, [MeasurementEnded(outcome) for outcome in outcomes])
    with History(path) as history:
        assert [found.number for found in history.measurements()] == [example.OUTCOME.number]


def frames(path: Path) -> list[int]:
    with closing(sqlite3.connect(path)) as connection:
        return [k for (k,) in connection.execute("SELECT k FROM frame ORDER BY k")]


def test_frames_of_an_earlier_run_that_was_not_read_are_left_out_when_it_is_mended(tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    with Store(path, "boot1", SteppedClock(), commit_s=0.01) as store:
        store.begin("{}", "hash", "versions")
        for k in (20, 21):
            frame, decision = step(k)
            store.record(FrameMade(frame))
            store.record(DecisionMade(decision))
        store.flush()
        with closing(sqlite3.connect(path, timeout=60.0)) as other, other:
            other.execute("INSERT INTO boot SELECT 0, 'boot0', began, config, fingerprint, versions FROM boot")
            for k in (19, 22):
                columns = "?, 'boot0', inputs, valid, errors, sigma"
                other.execute(f"INSERT INTO frame SELECT {columns} FROM frame WHERE k = 20", (k,))
                columns = "?, phase, predicted, corrected, sigma, limits, measure, training, events"
                other.execute(f"INSERT INTO decision SELECT {columns} FROM decision WHERE k = 20", (k,))
        assert frames(path) == [19, 20, 21, 22]
        with store.same_file() as file:
            pass
        damage = sqlite3.DatabaseError("database disk image is malformed")
        damage.sqlite_errorcode = sqlite3.SQLITE_CORRUPT
        store.repair(damage, file)
        assert frames(path) == [19, 20, 21]


def test_a_file_that_cannot_be_looked_through_is_damaged(tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    with Store(path, "boot1", SteppedClock(), commit_s=LONG_S, look_s=LONG_S) as store:
        store.begin("{}", "hash", "versions")
        store.flush()
        with closing(sqlite3.connect(path, timeout=60.0)) as other:
            other.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        with path.open("r+b") as file:
            file.seek(4096)
            file.write(b"\xff" * (path.stat().st_size - 4096))
        with store.same_file() as number:
            pass
        store.repair(DriverError("an answer that came from the file", device="nc"), number)
        assert "was damaged" in store.health.mended
