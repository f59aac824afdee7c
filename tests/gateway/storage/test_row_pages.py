"""Rows after a position: every one once, in order, whatever happens to the gateway and to its database."""

import json
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.base import Quality
from gateway.config.file import parse
from gateway.model.codes import NoticeCode
from gateway.model.commands import Command, CommandName, CommandOutcome
from gateway.model.events import (
    CommandGiven,
    DecisionMade,
    EventReported,
    FrameMade,
    MeasurementEnded,
    ReadingsTaken,
    ReasonsGiven,
)
from gateway.model.probing import Outcome
from gateway.model.sample import Sample
from gateway.model.text import Text, plain
from gateway.model.wording import event_of
from gateway.storage.epochs import NUMBERS, Position
from gateway.storage.faults import StoreError
from gateway.storage.readings import Pruning, Retention
from gateway.storage.row_pages import RowsPage, rows_after
from gateway.storage.schema import connect
from gateway.storage.store import Store
from talc.frame import Event, EventKind, Frame, Measurement, Why
from tests.benches import telemetry_examples as example
from tests.benches.service_file import MACHINE, adam6015
from tests.benches.stepped_clock import EPOCH, SteppedClock
from tests.benches.telemetry_peer import problem

TEXT = MACHINE + adam6015("bed = 0, column = 1")


class Asker:
    """Asks for what follows and keeps what it got; goes back an epoch when the store does not know the asker's
    epoch."""

    def __init__(self, path: Path, limit: int = 7) -> None:
        self.path, self.limit = path, limit
        self.seen: dict[str, list[tuple[str, int]]] = {table: [] for table in NUMBERS}
        self.known: dict[str, list[Position]] = {table: [] for table in NUMBERS}
        self.thinned: dict[str, int] = {}
        self.cells: dict[str, list[list[Any]]] = {table: [] for table in NUMBERS}

    def catch_up(self) -> None:
        for table in NUMBERS:
            while self.take(table):
                pass

    def take(self, table: str) -> bool:
        known = self.known[table]
        page = rows_after(self.path, {table: known[-1] if known else None}, self.limit)[table]
        assert isinstance(page, RowsPage), page
        if page.epoch is None:
            known.pop()
            return True
        if page.thinned is not None:
            self.thinned[table] = page.thinned
        self.seen[table] += [(page.epoch, number) for number in page.numbers]
        self.cells[table] += map(list, page.rows)
        if known and known[-1].epoch == page.epoch:
            known.pop()
        known.append(Position(page.epoch, page.last))
        return page.more


def event(store: Store, *texts: str) -> None:
    for text in texts:
        store.record(problem(text))


def texts(asker: Asker) -> list[object]:
    return [cells[3] for cells in asker.cells["events"]]


def read(store: Store, *sequences: int) -> None:
    for number in sequences:
        samples = (Sample(c, float(number), "degC", Quality.GOOD, EPOCH, 0.0, sequence=number) for c in "ab")
        store.record(ReadingsTaken(list(samples)))


def test_every_row_of_every_table_comes_once_and_in_order_while_the_gateway_writes_and_restarts(
    tmp_path: Path,
) -> None:
    path = tmp_path / "g.sqlite"
    asker = Asker(path, limit=3)
    for run in range(3):
        with Store(path, f"boot-{run}", SteppedClock()) as store:
            for n in range(10):
                read(store, n + 1)
                k = 10 * run + n
                store.record(FrameMade(Frame(k, np.array([20.5, np.nan]), np.array([True, False]))))
                store.record(DecisionMade(replace(example.DECISION, k=k)))
                event(store, f"{run}.{n}")
                if n in (4, 9):
                    store.flush()
                    asker.take("steps")  # some of it, and on after the restart
                    asker.take("events")
    asker.catch_up()
    assert [number for _, number in asker.seen["steps"]] == list(range(30))
    assert texts(asker) == [f"{run}.{n}" for run in range(3) for n in range(10)]
    readings = [(*cells[1:3], *cells[6:]) for cells in asker.cells["readings"]]
    assert readings == [(c, float(n), run, n) for run in (1, 2, 3) for n in range(1, 11) for c in "ab"]
    assert len({epoch for epoch, _ in asker.seen["steps"]}) == 3
    for table, seen in asker.seen.items():
        assert len(set(seen)) == len(seen), table


def test_commands_and_starts_come_too(tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    config = parse(TEXT.replace("[machine]", '[machine]\nkind = "dmu"') + "[talc.learner]\nlimit_um = 4.0\n", path)
    asker = Asker(path, limit=1)
    for run, name in enumerate((CommandName.PAUSE, CommandName.RESUME)):
        with Store(path, f"boot-{run}", SteppedClock()) as store:
            store.begin(config.canonical(), config.fingerprint(), "python 3")
            store.record(
                CommandGiven(CommandOutcome(Command(name, "anna"), EPOCH, accepted=run == 0, text=plain(f"no {run}")))
            )
    asker.catch_up()
    assert asker.cells["commands"] == [[EPOCH, "pause", "anna", 1, "no 0"], [EPOCH, "resume", "anna", 0, "no 1"]]
    (first, second) = asker.cells["runs"]
    assert first[:5] == [EPOCH, 1, "dmu", 300.0, '["bed", "column"]']
    assert json.loads(first[5])["learner"]["limit_um"] == 4.0
    assert (second[1], second[6:]) == (2, [config.fingerprint(), "python 3"])


def test_the_learner_s_reasons_come_with_one_value_a_column(tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    asker = Asker(path)
    first = example.REASONS.errors[0]
    nothing = replace(first, estimate=np.nan, inputs=(("bed", np.nan),))
    with Store(path, "boot-1", SteppedClock()) as store:
        store.record(ReasonsGiven(replace(example.REASONS, k=7)))
        store.record(ReasonsGiven(replace(example.REASONS, k=8, errors=(nothing,))))
    asker.catch_up()
    page = rows_after(path, {"reasons": None}, 1)["reasons"]
    assert isinstance(page, RowsPage)
    whole, empty = (dict(zip(page.columns, cells, strict=True)) for cells in asker.cells["reasons"])
    unit = next(name for name in page.columns if name.startswith(f"estimate_{first.error}")).split(first.error)[1]
    assert (whole["time"], whole["k"], whole["next_k"], whole["next_why"]) == (
        EPOCH, 7, example.REASONS.next_k, example.REASONS.next_why.value,
    )  # fmt: skip
    for name in ("estimate", "believed", "level", "other_inputs", "expected", "expected_sigma"):
        assert whole[f"{name}_{first.error}{unit}"] == getattr(first, name), name
    assert json.loads(whole["inputs"])[first.error] == dict(first.inputs)
    assert json.loads(whole["experts"])[first.error] == dict(first.experts)
    assert np.isnan(empty[f"estimate_{first.error}{unit}"])
    assert json.loads(empty["inputs"]) == {first.error: {"bed": None}}


def test_what_a_frame_is_learnt_from_comes_with_its_step(tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    asker = Asker(path)
    with Store(path, "boot-1", SteppedClock()) as store:
        for k, unknown in enumerate((False, True)):
            measured = Measurement(np.arange(9.0), np.full(9, 0.5 + k))
            store.record(FrameMade(Frame(k, np.array([20.5]), np.array([True]), measured, unknown)))
            store.record(DecisionMade(replace(example.DECISION, k=k)))
    asker.catch_up()
    assert [cells[-10:] for cells in asker.cells["steps"]] == [[*[0.5] * 9, 0], [*[1.5] * 9, 1]]


def test_a_frame_on_which_nothing_was_decided_is_not_returned(tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    asker = Asker(path)
    with Store(path, "boot-1", SteppedClock()) as store:
        store.record(FrameMade(example.FRAME))
        store.flush()
        asker.catch_up()
        assert asker.seen["steps"] == []


def test_what_an_earlier_program_left_is_returned_too(tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    with Store(path, "boot-1", SteppedClock()) as store:
        event(store, "early")
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("DROP TABLE epoch")
        connection.execute("DROP TABLE thinned")
    with Store(path, "boot-2", SteppedClock()) as store:
        event(store, "late")
    asker = Asker(path)
    asker.catch_up()
    assert texts(asker) == ["early", "late"]


def test_inputs_that_change_come_in_separate_pages(tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    one, two = parse(TEXT, path), parse(TEXT.replace("column", "table"), path)
    for boot, config in enumerate((one, two)):
        with Store(path, f"boot-{boot}", SteppedClock()) as store:
            store.begin(config.canonical(), config.fingerprint(), "")
            for k in range(3 * boot, 3 * boot + 3):
                store.record(FrameMade(Frame(k, np.array([20.5 + k, np.nan]), np.array([True, False]))))
                store.record(DecisionMade(replace(example.DECISION, k=k)))
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("DELETE FROM epoch WHERE number > 1")  # not even an epoch parts them
    first = rows_after(path, {"steps": None}, 10)["steps"]
    assert isinstance(first, RowsPage)
    assert (first.numbers, first.more, list(first.columns)[3:5]) == ([0, 1, 2], True, ["input_bed", "input_column"])
    assert first.epoch is not None
    second = rows_after(path, {"steps": Position(first.epoch, first.last)}, 10)["steps"]
    assert isinstance(second, RowsPage)
    assert (second.numbers, second.more, list(second.columns)[3:5]) == ([3, 4, 5], False, ["input_bed", "input_table"])
    assert list(second.rows[0])[:5] == [3, datetime.fromtimestamp(900.0, UTC), "compensation", 23.5, None]


def test_rows_that_became_old_before_they_were_asked_for_are_reported_as_a_gap(tmp_path: Path) -> None:
    path, day = tmp_path / "g.sqlite", 86400.0
    asked, never = Asker(path), Asker(path)
    with Store(path, "boot-1", SteppedClock()) as store:
        read(store, *range(1, 5))
        store.flush()
        asked.catch_up()
        read(store, *range(5, 9))
        event(store, "kept")
    with closing(connect(path)) as connection, connection:
        pruning = Pruning(Retention(samples_days=1.0), 0.0)
        pruning.prune(connection, 100.0)
        pruning.prune(connection, 3 * day)
    asked.catch_up()
    never.catch_up()
    assert [number for _, number in asked.seen["readings"][:8]] == [number for _, number in asked.seen["readings"]][:8]
    assert len(asked.seen["readings"]) == 8 + 1, "the newest stays"
    assert asked.thinned.keys() == never.thinned.keys() == {"readings"}
    assert texts(asked) == texts(never) == ["kept"]
    means = [tuple(cells[1:5]) for cells in never.cells["minutes"]]
    assert means == [("a", "degC", 8, 4.5), ("b", "degC", 7, 4.0)]


def test_whoever_has_every_row_that_was_deleted_hears_of_no_gap(tmp_path: Path) -> None:
    path, day = tmp_path / "g.sqlite", 86400.0
    asker, pruning = Asker(path), Pruning(Retention(samples_days=1.0), 0.0)
    with Store(path, "boot-1", SteppedClock()) as store:
        read(store, 1, 2)
    asker.catch_up()
    with closing(connect(path)) as connection, connection:
        pruning.prune(connection, 100.0)
    with Store(path, "boot-2", SteppedClock()) as store:
        read(store, 3)
    with closing(connect(path)) as connection, connection:
        pruning.prune(connection, 3 * day)
        (upto,) = connection.execute("SELECT upto FROM thinned WHERE name = 'readings'").fetchone()
    assert upto == asker.seen["readings"][-1][1], "deleted up to the last row that was asked for"
    asker.catch_up()
    assert asker.thinned == {}
    assert [cells[7] for cells in asker.cells["readings"]] == [1, 1, 2, 2, 3, 3]


def restored(path: Path, copy: Path) -> None:
    for ending in ("-wal", "-shm"):
        path.with_name(path.name + ending).unlink(missing_ok=True)
    copy.replace(path)


def test_a_backup_that_is_put_back_hides_no_row_and_repeats_none(tmp_path: Path) -> None:
    path, copy = tmp_path / "g.sqlite", tmp_path / "copy.sqlite"
    asker = Asker(path, limit=2)
    with Store(path, "boot-1", SteppedClock()) as store:
        event(store, "1", "2", "3")
        store.flush()
        with closing(sqlite3.connect(path)) as source, closing(sqlite3.connect(copy)) as target:
            source.backup(target)
        event(store, "4", "5")
    asker.catch_up()
    with Store(path, "boot-2", SteppedClock()) as store:
        event(store, "6")
    asker.catch_up()
    restored(path, copy)
    with Store(path, "boot-3", SteppedClock()) as store:
        event(store, "4 again", "5 again", "6 again", "7")
    asker.catch_up()
    assert texts(asker) == ["1", "2", "3", "4", "5", "6", "4 again", "5 again", "6 again", "7"]


def test_a_database_that_is_mended_hides_no_row_and_repeats_none(tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    asker = Asker(path)
    config = parse(TEXT, path)
    with Store(path, "boot-1", SteppedClock()) as store:
        store.begin(config.canonical(), config.fingerprint(), "")
        measured = Measurement(np.arange(9.0), np.full(9, 0.5))
        store.record(
            MeasurementEnded(Outcome(7, Why.INTERVAL, EPOCH, EPOCH, np.zeros((6, 3)), (0.0, 0.0, 0.0), measured, 0.4))
        )
        event(store, *map(str, range(10)))
        read(store, 1, 2)
    asker.catch_up()
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("UPDATE event SET time = x'00' WHERE id > 6")  # the newest are lost
        connection.execute("UPDATE decision SET phase = 'none'")
    with Store(path, "boot-2", SteppedClock()) as store:
        with store.same_file() as file:
            pass
        store.repair(ValueError("damaged"), file)
        event(store, "after")
        read(store, 3)
    asker.catch_up()
    assert texts(asker) == [*map(str, range(10)), "after"]
    assert len(asker.cells["measurements"]) == 1
    assert [cells[7] for cells in asker.cells["readings"]] == [1, 1, 2, 2, 3, 3]


def test_a_table_that_cannot_be_read_does_not_hold_up_the_others(tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    with Store(path, "boot-1", SteppedClock()) as store:
        event(store, "one")
        read(store, 1)
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("UPDATE event SET time = 'noon'")
    found = rows_after(path, {"events": None, "readings": None}, 10)
    assert isinstance(found["events"], StoreError)
    assert "events cannot be read" in str(found["events"])
    assert isinstance(found["readings"], RowsPage)
    assert len(found["readings"].numbers) == 2


@pytest.fixture
def written(tmp_path: Path) -> Iterator[Path]:
    path = tmp_path / "g.sqlite"
    with Store(path, "boot-1", SteppedClock()) as store:
        event(store, "1", "2", "3")
        store.flush()
        yield path


def test_no_position_whoever_sends_it_changes_what_others_get(written: Path) -> None:
    whole = rows_after(written, {"events": None}, 10)["events"]
    assert isinstance(whole, RowsPage)
    assert whole.epoch is not None
    for number in (3, 3, 2, 10**6, 2**63 - 1, -(2**63)):  # twice, back, beyond the end, absurd
        page = rows_after(written, {"events": Position(whole.epoch, number)}, 10)["events"]
        assert isinstance(page, RowsPage)
        assert page.numbers == [n for n in (1, 2, 3) if n > number]
    stranger = rows_after(written, {"events": Position("0" * 32, 3)}, 10)["events"]
    assert isinstance(stranger, RowsPage)
    assert (stranger.epoch, stranger.rows) == (None, [])
    again = rows_after(written, {"events": None}, 10)["events"]
    assert again == whole


def test_a_table_that_does_not_exist_is_named(written: Path) -> None:
    with pytest.raises(ValueError, match="frames: "):
        rows_after(written, {"frames": None}, 10)
    with pytest.raises(StoreError, match="gone"):
        rows_after(written.with_name("gone"), {"events": None}, 10)


def test_an_event_has_its_code_and_values_and_one_of_words_alone_has_none(tmp_path: Path) -> None:
    path, slow = tmp_path / "g.sqlite", Text(NoticeCode.ANSWERS_AGAIN, subject="device rtd1")
    with Store(path, "boot-1", SteppedClock()) as store:
        store.record(EventReported(event_of(EventKind.OPERATOR, slow), None))
        store.record(EventReported(Event(EventKind.OPERATOR, "words of an earlier program"), None))
        store.flush()
    page = rows_after(path, {"events": None}, 10)["events"]
    assert not isinstance(page, StoreError)
    assert [cells[-2:] for cells in page.rows] == [("answers_again", '{"subject": "device rtd1"}'), (None, None)]
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("DROP TABLE coded")  # as in a store of an earlier program
    earlier = rows_after(path, {"events": None}, 10)["events"]
    assert not isinstance(earlier, StoreError)
    assert [cells[-2:] for cells in earlier.rows] == [(None, None), (None, None)]
