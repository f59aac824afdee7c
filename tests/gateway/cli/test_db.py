"""`talc-gateway db` on a database that a gateway writes to."""

import csv
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
from pyarrow import parquet

from drivers.base import Quality
from gateway.config.file import parse
from gateway.model.commands import Command, CommandName, CommandOutcome
from gateway.model.compensation import Source, Step, Write
from gateway.model.events import (
    CommandGiven,
    CompensationStepped,
    DecisionMade,
    EventReported,
    FrameMade,
    MeasurementEnded,
    ReadingsTaken,
)
from gateway.model.probing import Outcome
from gateway.model.sample import Sample
from gateway.model.text import plain
from gateway.storage.epochs import Position
from gateway.storage.history import History
from gateway.storage.row_pages import RowsPage, rows_after
from gateway.storage.store import Store
from talc.control import Controller
from talc.frame import Event, EventKind, Frame, Measurement, Why
from tests.benches.command import here
from tests.benches.service_file import MACHINE, adam6015
from tests.benches.stepped_clock import EPOCH, SteppedClock

TEXT = MACHINE + adam6015("bed = 0, column = 1")
STEPS = 12
MEASURED = Measurement(np.arange(9.0), np.full(9, 0.5))
STILL = Step((1.0, 2.0, 3.0), (1.0, 2.0, 3.0), Source.PREDICTION, (False, False, False))


@pytest.fixture
def running(tmp_path: Path) -> Iterator[Path]:
    """A database that is open for writing."""
    config = parse(TEXT, tmp_path / "gateway.toml")
    controller = Controller(config.input_names, config.talc)
    with Store(tmp_path / "g.sqlite", "boot", SteppedClock(), commit_s=0.01) as store:
        store.begin(config.canonical(), config.fingerprint(), "")
        for k in range(STEPS):
            measured = MEASURED if k == 5 else None
            frame = Frame(k, np.array([20.5 + k, np.nan]), np.array([True, False]), measured)
            store.record(ReadingsTaken([Sample("bed", 20.5 + k, "degC", Quality.GOOD, EPOCH, 0.0, sequence=k)]))
            store.record(FrameMade(frame))
            store.record(DecisionMade(controller.step(frame)))
        centres = np.zeros((6, 3))
        store.record(MeasurementEnded(Outcome(7, Why.INTERVAL, EPOCH, EPOCH, centres, (0.0, 0.0, 0.0), MEASURED, 0.4)))
        store.record(EventReported(Event(EventKind.PROBLEM, 'a "quoted", text'), 3))
        store.record(
            CommandGiven(CommandOutcome(Command(CommandName.PAUSE, "anna"), EPOCH, accepted=True, text=plain("it is")))
        )
        store.record(CompensationStepped(Write(EPOCH, "compensate", STILL, 4, {"X": 1.0}, True, None)))
        store.flush()
        yield tmp_path / "g.sqlite"


def exported(database: Path, table: str) -> list[dict[str, str]]:
    file = database.with_name(f"{table}.csv")
    answer = here("db", "export", database, table, "-o", file)
    assert answer.code == 0, answer.together
    with file.open(newline="", encoding="utf-8") as found:
        return list(csv.DictReader(found))


def test_steps_are_exported_with_a_column_for_each_value(running: Path) -> None:
    rows = exported(running, "steps")
    assert len(rows) == STEPS
    assert (rows[5]["k"], rows[5]["time"]) == ("5", "1970-01-01T00:25:00+00:00")
    assert (rows[5]["input_bed"], rows[5]["input_column"]) == ("25.5", "")
    assert [rows[5]["measured_EY0A_um"], rows[5]["measured_EC0C_um_per_m"]] == ["0.0", "8.0"]
    assert rows[4]["measured_EY0A_um"] == ""
    assert rows[5]["phase"] == "compensation"


def test_the_other_tables_are_exported_too(running: Path) -> None:
    (reading, *_), (measured,), (event,), (step,) = (
        exported(running, table) for table in ("readings", "measurements", "events", "compensation")
    )
    assert [reading[n] for n in ("time", "channel", "value", "unit", "quality", "run")] == [
        EPOCH.isoformat(), "bed", "20.5", "degC", "good", "1",
    ]  # fmt: skip
    assert (measured["number"], measured["measured_EC0C_um_per_m"], measured["rejected_because"]) == ("7", "8.0", "")
    assert (event["kind"], event["text"], event["value"]) == ("problem", 'a "quoted", text', "")
    assert (step["x_um"], step["z_um"], step["written"]) == ("1.0", "3.0", "1")
    (command,), (run_,) = exported(running, "commands"), exported(running, "runs")
    assert list(command.values()) == [EPOCH.isoformat(), "pause", "anna", "1", "it is"]
    assert [run_[n] for n in ("run", "kind", "step_s", "inputs")] == ["1", "", "300.0", '["bed", "column"]']
    assert exported(running, "minutes") == []


def test_parquet_contains_the_same_with_types(running: Path) -> None:
    file = running.with_name("steps.parquet")
    assert here("db", "export", running, "steps", "-o", file).code == 0
    found = parquet.read_table(file).to_pylist()
    assert len(found) == STEPS
    assert isinstance(found[5]["time"], datetime)
    assert (found[5]["input_bed"], found[5]["input_column"], found[5]["measured_EC0C_um_per_m"]) == (25.5, None, 8.0)


def test_a_name_of_another_kind_is_refused(running: Path) -> None:
    answer = here("db", "export", running, "steps", "-o", running.with_name("steps.txt"))
    assert answer.code == 2
    assert "ends in .csv or .parquet" in answer.together


def test_a_backup_is_whole_while_the_gateway_writes(running: Path) -> None:
    copy = running.with_name("copy.sqlite")
    assert here("db", "backup", running, "-o", copy).code == 0
    assert here("db", "backup", running, "-o", copy).code == 2, "nothing is overwritten"
    with History(copy) as history:
        assert [step.frame.k for step in history.steps()] == list(range(STEPS))
    assert sorted(p.name for p in running.parent.glob("copy*")) == ["copy.sqlite"]


def test_another_computer_goes_on_from_a_backup_without_readings(running: Path) -> None:
    copy = running.with_name("copy.sqlite")
    assert here("db", "backup", running, "-o", copy, "--without-readings").code == 0
    assert here("db", "check", copy).together == f"{copy}: whole\n"
    learnt = [path.with_suffix(".json") for path in (running, copy)]
    for database, file in zip((running, copy), learnt, strict=True):
        assert here("db", "export-learnt", database, "-o", file).code == 0
    assert learnt[0].read_text(encoding="utf-8") == learnt[1].read_text(encoding="utf-8")
    with History(copy) as history:
        assert (history.last_number(), history.paused() is not None) == (7, True)
    assert [row["sequence"] for row in exported(copy, "readings")] == [str(STEPS - 1)], "so that numbers go on"
    had = page_after(running, None)
    with Store(copy, "boot on another computer", SteppedClock()) as store:
        store.begin("{}", "", "")
        store.record(ReadingsTaken([Sample("bed", 40.0, "degC", Quality.GOOD, EPOCH, 0.0, sequence=0)]))
        store.flush()
        new = page_after(copy, Position(str(had.epoch), had.numbers[-1]))
        assert (len(new.numbers), new.thinned) == (1, None), "a collector gets what it did not have"
        assert page_after(copy, None).thinned == had.numbers[-1] - 1, "and is told what is missing"


def page_after(database: Path, position: Position | None) -> RowsPage:
    found = rows_after(database, {"readings": position}, 100)["readings"]
    assert isinstance(found, RowsPage)
    return found


def test_stats_tell_rows_and_sizes(running: Path) -> None:
    answer = here("db", "stats", running)
    assert answer.code == 0, answer.together
    counts = {line.split()[0]: line.split()[1] for line in answer.together.splitlines()}
    assert (counts["steps"], counts["readings"], counts["measurements"]) == (str(STEPS), str(STEPS), "1")
    sizes = [float(line.split()[-1]) for line in answer.together.splitlines()[1:] if "." in line.split()[-1]]
    assert sum(sizes) > 0.02
    assert f"steps 0 to {STEPS - 1}" in answer.together


def test_check_finds_invalid_rows_and_passes_a_whole_database(running: Path) -> None:
    answer = here("db", "check", running)
    assert (answer.code, answer.together) == (0, f"{running}: whole\n")
    with closing(sqlite3.connect(running)) as connection, connection:
        connection.execute("UPDATE frame SET inputs = x'00' WHERE k = 3")
    answer = here("db", "check", running)
    assert answer.code == 1
    assert f"{running}: steps: 1 " in answer.together, "as `db stats` calls them"


def test_check_and_backup_name_a_damaged_page_of_readings(running: Path) -> None:
    copy = running.with_name("copy.sqlite")
    assert here("db", "backup", running, "-o", copy).code == 0
    with closing(sqlite3.connect(copy)) as connection:
        (page,) = connection.execute("SELECT rootpage FROM sqlite_master WHERE name = 'reading'").fetchone()
        (size,) = connection.execute("PRAGMA page_size").fetchone()
    with copy.open("r+b") as file:
        file.seek((page - 1) * size)
        file.write(bytes(size))
    assert here("db", "check", copy).code == 1
    answer = here("db", "backup", copy, "-o", copy.with_name("again.sqlite"))
    assert answer.code == 1, "it is made, and told"
    assert copy.with_name("again.sqlite").stat().st_size == copy.stat().st_size
    assert "readings" in answer.together, answer.together


@pytest.mark.parametrize("damage", ["cut", "no JSON", "no text"])
def test_of_a_damaged_database_each_command_says_so_and_what_to_do(damage: str, running: Path) -> None:
    copy = running.with_name("copy.sqlite")
    assert here("db", "backup", running, "-o", copy).code == 0
    if damage == "cut":
        copy.write_bytes(copy.read_bytes()[:-4096])
        assert here("db", "check", copy).code == 1
    elif damage == "no JSON":
        with closing(sqlite3.connect(copy)) as connection, connection:
            connection.execute("UPDATE decision SET events = '[{' WHERE k = 3")
    else:
        content = copy.read_bytes()
        copy.write_bytes(content.replace(b"CREATE TABLE event", b"CREATE TABLE \xcc\xd5ent"))
    said = 0
    for command in (("db", "stats"), ("db", "export-learnt"), ("db", "backup"), ("replay",), ("report",)):
        output = () if command in (("db", "stats"), ("replay",)) else ("-o", copy.with_name(f"{command[-1]}.json"))
        answer = here(*command, copy, *output)
        assert answer.code in (0, 1, 3), answer.together
        assert (answer.code == 3) == ("error: " in answer.together)
        said += answer.code == 3
    assert said >= 2
