"""The database: exact, bounded, one writer, and intact however the process ends."""

import fcntl
import math
import random
import shutil
import signal
import sqlite3
import subprocess
import sys
from contextlib import closing
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest

from drivers.base import Quality
from gateway.config.applied import ConfigurationApplied
from gateway.model.codes import NoticeCode
from gateway.model.compensation import Source, Step, Write
from gateway.model.events import (
    CompensationStepped,
    DecisionMade,
    FrameMade,
    MeasurementEnded,
    ModelsAdopted,
    ReadingsTaken,
)
from gateway.model.probing import End, Outcome
from gateway.model.sample import Sample
from gateway.model.text import Text, values_of
from gateway.nc.settings import Identity
from gateway.storage.faults import StoreError
from gateway.storage.history import History
from gateway.storage.store import Store, boot_id
from talc.frame import Decision, Event, EventKind, Frame, Measurement, Phase, Why
from talc.models import ModelSet, TrainingNote
from tests.benches.database import applied
from tests.benches.failing_disk import on_failing_disk
from tests.benches.stepped_clock import EPOCH, SteppedClock
from tests.benches.store_writer import step
from tests.benches.telemetry_examples import configuration

ROOT = Path(__file__).parents[3]
AWKWARD = np.array([math.nan, -0.0, 0.1 + 0.2, 5e-324, 1.7976931348623157e308, -math.pi, math.inf, 1 / 3, 20.1])


def store_at(path: Path) -> Store:
    return Store(path, "boot1", SteppedClock())


def reading(channel: str = "a", sequence: int = 1, value: float = 20.0) -> Sample:
    return Sample(channel, value, "degC", Quality.GOOD, EPOCH, 0.0, sequence=sequence)


def test_a_channel_beyond_the_numbers_of_a_database_is_left_out_and_the_others_keep_their_values(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Its number would overflow into those of the read and the channel: its values would appear as another
    channel's."""
    path, channels = tmp_path / "a.sqlite", 2060
    for sequence in (1, 2):  # the second time the numbers come from the file
        readings = [reading(f"c{n}", sequence, float(n)) for n in range(channels)]
        with store_at(path) as store:
            for start in range(0, channels, 100):
                store.record(ReadingsTaken(readings[start : start + 100]))
    with closing(sqlite3.connect(path)) as connection:
        found = connection.execute("SELECT channel, value, sequence FROM sample").fetchall()
    assert len(found) == 2 * 2047
    assert all(channel == f"c{value:.0f}" for channel, value, _ in found)
    assert {sequence for _, _, sequence in found} == {1, 2}
    told = [r.message for r in caplog.records if "as many as it can number: channel c2047" in r.message]
    assert len(told) == 2, "once for each run"


def decision(k: int, events: tuple[Event, ...] = ()) -> Decision:
    limits = AWKWARD[::-1].copy()
    return Decision(k, Phase.COMPENSATION, AWKWARD, AWKWARD * 0.5, AWKWARD + 1, limits, Why.INTERVAL, None, events)


def no_models(k: int) -> ModelSet:
    return ModelSet(
        k=k,
        why="calibration",
        input_names=("a",),
        models=(None,) * 9,
        notes=(TrainingNote.from_plain("nothing to learn"),),
    )


def same_bits(a: object, b: object) -> bool:
    return np.asarray(a, dtype="<f8").tobytes() == np.asarray(b, dtype="<f8").tobytes()


def rows(path: Path, query: str) -> list[tuple[object, ...]]:
    with closing(sqlite3.connect(path)) as connection:
        return list(connection.execute(query))


def test_steps_come_back_bit_for_bit_in_order_with_the_models_adopted_after_them(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "g.sqlite"
    measurement = Measurement(AWKWARD, AWKWARD[::-1].copy())
    event = Event(EventKind.LIMIT_EXCEEDED, "EY0A exceeds its limit", "EY0A", 0.1 + 0.2, 5.0)
    valid = np.array([True, False] * 4 + [True])
    with store_at(path) as store:
        for k in (5, 6, 9):
            store.record(FrameMade(Frame(k, AWKWARD, valid, measurement if k == 6 else None)))
            store.record(DecisionMade(decision(k, (event,) if k == 9 else ())))
            if k == 6:
                store.record(ModelsAdopted(no_models(6), after_k=6))
                store.record(ModelsAdopted(no_models(60), after_k=6))
    with History(path) as history:
        steps = list(history.steps())
    assert [s.frame.k for s in steps] == [5, 6, 9]
    assert [[m.k for m in s.adopted] for s in steps] == [[], [6, 60], []]
    assert steps[1].adopted[0].fingerprint() == no_models(6).fingerprint()
    for found in steps:
        assert same_bits(found.frame.inputs, AWKWARD)
        assert found.frame.valid.tolist() == valid.tolist()
        wanted = decision(found.frame.k)
        for name in ("predicted", "corrected", "sigma", "limits"):
            assert same_bits(getattr(found.decision, name), getattr(wanted, name))
        assert (found.decision.phase, found.decision.measure) == (Phase.COMPENSATION, Why.INTERVAL)
    assert steps[0].frame.measurement is None
    assert steps[1].frame.measurement is not None
    assert same_bits(steps[1].frame.measurement.errors, AWKWARD)
    assert steps[2].decision.events == (event,)


REFUSAL = Text(NoticeCode.RESULT_SURPRISING, error="EY0A", difference=6.4, unit="µm")


def test_measurements_keep_the_raw_centres_and_why_they_were_refused(tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    centres = np.arange(18.0).reshape(6, 3) / 7.0
    later = EPOCH + timedelta(seconds=120)
    good = Measurement(AWKWARD, AWKWARD)
    with store_at(path) as store:
        store.record(MeasurementEnded(Outcome(1, Why.CALIBRATION, EPOCH, later, centres, (1.0, 2.0, 1 / 3), good, 0.4)))
        store.record(
            MeasurementEnded(
                Outcome(
                    2,
                    Why.RETRY,
                    EPOCH,
                    later,
                    None,
                    (0.0, 0.0, 0.0),
                    None,
                    math.nan,
                    REFUSAL,
                    End.REFUSED,
                )
            )
        )
    with History(path) as history:
        accepted, refused = history.measurements()
    assert accepted.centres_mm is not None
    assert same_bits(accepted.centres_mm, centres)
    assert same_bits(accepted.in_force_um, (1.0, 2.0, 1 / 3))
    assert same_bits(accepted.errors, AWKWARD)
    assert (refused.centres_mm, refused.errors, refused.reason) == (None, None, REFUSAL)
    assert values_of(refused.reason) == values_of(REFUSAL)


def test_every_write_to_the_control_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    taken = Step((10.0, 0.0, -3.0), (1.0, 0.0, -1 / 3), Source.PREDICTION, (False, False, False))
    with store_at(path) as store:
        store.record(CompensationStepped(Write(EPOCH, "compensate", taken, 7, {"X": 1.0}, True, (1.0, 0.0, -0.25))))
        store.record(CompensationStepped(Write(EPOCH, "monitor", taken, None, {}, False, None)))
    with History(path) as history:
        first, second = history.compensation()
    assert (first.time, first.mode, first.written) == (EPOCH, "compensate", True)
    assert same_bits(first.offsets_um, (1.0, 0.0, -1 / 3))
    assert not second.written
    ((target, read_back, positions, k),) = rows(
        path, "SELECT target, read_back, positions, k FROM compensation LIMIT 1"
    )
    assert same_bits(np.frombuffer(bytes(target)), (10.0, 0.0, -3.0))  # type: ignore[call-overload]
    assert same_bits(np.frombuffer(bytes(read_back)), (1.0, 0.0, -0.25))  # type: ignore[call-overload]
    assert (positions, k) == ('{"X": 1.0}', 7)


def test_a_reading_handed_in_twice_is_kept_once(tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    with store_at(path) as store:
        store.record(ReadingsTaken([reading("a", 1), reading("b", 1)]))
        store.record(ReadingsTaken([reading("a", 1), reading("a", 2, math.nan)]))
    with Store(path, "boot2", SteppedClock()) as store:
        store.begin("{}", "hash", "versions")
        store.record(ReadingsTaken([reading("a", 1)]))  # another boot starts the count again
    assert rows(path, "SELECT boot, sequence, channel, value FROM sample ORDER BY boot, channel, sequence") == [
        (1, 1, "a", 20.0),
        (1, 2, "a", None),
        (1, 1, "b", 20.0),
        (2, 1, "a", 20.0),
    ]
    assert rows(path, "SELECT number, id FROM boot") == [(2, "boot2")]
    with History(path) as history:
        assert history.channel_health() == {"a": {"good": 3}, "b": {"good": 1}}


def test_a_second_gateway_is_refused_and_the_lock_goes_with_the_first(tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    with store_at(path), pytest.raises(StoreError, match="another gateway writes to it"):
        store_at(path)
    assert [p.name for p in tmp_path.iterdir()] == ["g.sqlite"]
    with store_at(path):
        pass


def test_a_gateway_of_another_container_is_refused_by_the_file_alone(tmp_path: Path) -> None:
    """The kernel's name is not visible from there, but the lock on the file is."""
    path = tmp_path / "g.sqlite"
    with path.with_name("g.sqlite.lock").open("w") as there:
        fcntl.flock(there, fcntl.LOCK_EX)
        with pytest.raises(StoreError, match="another gateway writes to it"):
            Store(path, "second", SteppedClock())
    with Store(path, "third", SteppedClock()):
        pass


def test_each_run_knows_the_one_before_it_and_two_copies_claim_as_two(tmp_path: Path) -> None:
    path, copy = tmp_path / "a.sqlite", tmp_path / "b.sqlite"
    boots = [boot_id() for _ in range(4)]
    for boot, earlier in zip(boots[:2], [None, boots[0]], strict=True):
        with Store(path, boot, SteppedClock(), origin="here") as store:
            assert store.predecessor == earlier
            store.begin("{}", "", "")
    shutil.copy(path, copy)
    with (
        Store(path, boots[2], SteppedClock(), origin="here") as original,
        Store(copy, boots[3], SteppedClock(), origin="here") as cloned,
    ):
        one, other = Identity.of(boots[2], original.predecessor), Identity.of(boots[3], cloned.predecessor)
    assert one.predecessor == other.predecessor == Identity.of(boots[1], None).owner
    assert len({one.owner, other.owner, one.predecessor}) == 3


def test_a_copy_of_what_runs_takes_nothing_over_on_another_computer(tmp_path: Path) -> None:
    path, copy = tmp_path / "a.sqlite", tmp_path / "b.sqlite"
    with Store(path, "first", SteppedClock(), origin="here") as store:
        assert store.predecessor is None
        store.begin("{}", "", "")
    with Store(path, "second", SteppedClock(), origin="here") as store:
        assert store.predecessor == "first", "a crash and a restart"
        store.begin("{}", "", "")
        store.flush()
        with closing(sqlite3.connect(path)) as source, closing(sqlite3.connect(copy)) as target:
            source.backup(target)
        with Store(copy, "third", SteppedClock(), origin="elsewhere") as cloned:
            assert cloned.predecessor is None
        with Store(copy, "third", SteppedClock(), origin="here") as cloned:
            assert cloned.predecessor == "second"
    with Store(path, "unnamed", SteppedClock()) as store:
        store.begin("{}", "", "")
    with Store(path, "fourth", SteppedClock()) as store:
        assert store.predecessor is None, "nothing says that it was the same computer"


def test_a_reader_sees_what_is_committed_while_the_gateway_writes(tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    with store_at(path) as store:
        store.begin('{"a":1}', "hash", "python")
        for k in range(5):
            store.record(FrameMade(Frame(k, AWKWARD, AWKWARD > 0)))
            store.record(DecisionMade(decision(k)))
            store.flush()
            with History(path) as history:
                assert len(list(history.steps())) == k + 1
                assert history.config() == ('{"a":1}', "hash", "python")


def test_the_configuration_that_a_reload_left_running_is_the_stored_one(tmp_path: Path) -> None:
    path, first, second = tmp_path / "g.sqlite", configuration("first"), configuration("second")
    with store_at(path) as store:
        store.begin('{"a":1}', "first", "python")
        store.record(ConfigurationApplied(first))
        store.record(ConfigurationApplied(second))
    with History(path) as history:
        assert history.config() == (second.canonical(), second.fingerprint(), "python")
    assert applied(path) == [(EPOCH, first.fingerprint()), (EPOCH, second.fingerprint())]
    with Store(path, "boot2", SteppedClock()) as store:
        store.begin('{"a":3}', "third", "python")
    with History(path) as history:
        assert history.config() == ('{"a":3}', "third", "python"), "what ran before the start counts no more"


def test_a_file_of_a_program_that_did_not_store_reloads_is_read_and_continued(tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    with store_at(path) as store:
        store.begin('{"a":1}', "first", "python")
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("DROP TABLE running")
    with History(path) as history:
        assert history.config() == ('{"a":1}', "first", "python")
    with Store(path, "boot2", SteppedClock()) as store:
        store.begin('{"a":1}', "first", "python")
        store.record(ConfigurationApplied(configuration("mill")))
    assert [mark for _, mark in applied(path)] == [configuration("mill").fingerprint()]


def test_files_that_are_not_ours_are_refused_and_left_alone(tmp_path: Path) -> None:
    text = tmp_path / "notes.txt"
    text.write_text("not a database, but long enough to be looked at as one " * 20)
    with pytest.raises(StoreError, match=r"notes\.txt: is not a database of this gateway"):
        store_at(text)
    assert text.read_text().startswith("not a database")
    foreign = tmp_path / "foreign.sqlite"
    with closing(sqlite3.connect(foreign)) as connection:
        connection.execute("CREATE TABLE customer (name TEXT)")
        connection.commit()
        for version in (0, 1, 4):
            connection.execute(f"PRAGMA user_version = {version}")
            before = foreign.read_bytes()
            with pytest.raises(StoreError, match="database of another program"):
                store_at(foreign)
            assert foreign.read_bytes() == before
    newer = tmp_path / "newer.sqlite"
    with closing(sqlite3.connect(newer)) as connection:
        connection.execute("PRAGMA user_version = 99")
    with pytest.raises(StoreError, match="schema version 99"):
        store_at(newer)
    with pytest.raises(StoreError, match="schema version 99"):
        History(newer)
    with pytest.raises(StoreError, match="no such file"):
        History(tmp_path / "none.sqlite")
    assert not list(tmp_path.glob("*.lock"))


def test_a_row_that_the_database_refuses_is_reported_and_the_others_are_stored(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    store = store_at(tmp_path / "g.sqlite")

    def write() -> None:
        with store:
            store.record(FrameMade(Frame(1, AWKWARD, AWKWARD > 0)))
            store.record(FrameMade(Frame(1, AWKWARD, AWKWARD > 0)))  # the same index twice: the database refuses
            store.flush()
            store.record(FrameMade(Frame(2, AWKWARD, AWKWARD > 0)))

    with pytest.raises(StoreError, match="UNIQUE constraint failed"):
        write()
    said = "the database refuses rows of the table frame: UNIQUE constraint failed: frame.k"
    assert store.health.problem == said
    assert [record.getMessage() for record in caplog.records] == [f"{tmp_path}/g.sqlite: {said}; please report this"]
    assert rows(tmp_path / "g.sqlite", "SELECT k FROM frame") == [(1,), (2,)]
    with store_at(tmp_path / "g.sqlite"):
        pass


@pytest.mark.slow
def test_killed_at_any_moment_nothing_committed_is_lost_and_nothing_is_torn(tmp_path: Path) -> None:
    path, rng, confirmed, first = tmp_path / "g.sqlite", random.Random(7), list[int](), 0
    environment = on_failing_disk(tmp_path)
    for life in range(9):
        # Before any call that changes the disk: of the first ones it opens the database, later it writes a step.
        call = rng.randint(1, 100 if life % 3 == 0 else 800)
        writer = subprocess.run(
            [sys.executable, "-m", "tests.benches.store_writer", str(path), str(first), str(call)],
            cwd=ROOT,
            env=environment,
            stdout=subprocess.PIPE,
            text=True,
            check=False,
        )
        assert writer.returncode == -signal.SIGKILL
        seen = [int(line) for line in writer.stdout.splitlines(keepends=True) if line.endswith("\n")]
        confirmed += seen
        first = (seen[-1] if seen else first - 1) + 2  # the one being written may have been committed
        with closing(sqlite3.connect(path)) as connection:
            assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    assert len(confirmed) > 30, "steps were written between deaths"
    with History(path) as history:
        stored = {s.frame.k: s for s in history.steps()}
    assert set(confirmed) <= set(stored)
    assert len(set(stored) - set(confirmed)) <= 15, "at most the one in flight per death"
    for k, found in stored.items():
        frame, made = step(k)
        assert same_bits(found.frame.inputs, frame.inputs)
        assert same_bits(found.decision.corrected, made.corrected)
    counted = {row[0]: row[1] for row in rows(path, "SELECT sequence, count(*) FROM sample GROUP BY sequence")}
    assert all(counted[k] == 30 for k in confirmed)
