"""A database of schema version 3, written by an earlier program, stays readable."""

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gateway.model.events import DecisionMade, FrameMade, ProbingRequested
from gateway.storage.history import History
from gateway.storage.store import Store
from talc.frame import Decision, FloatArray
from tests.benches import telemetry_examples as example
from tests.benches.database import applied
from tests.benches.stepped_clock import EPOCH, SteppedClock

DUMP = Path(__file__).with_name("version3.sql")
"""Never renewed: what was written then must stay readable."""
SECOND = replace(example.DECISION, k=8, events=(example.LIMIT, example.PROBLEM))


@pytest.fixture
def database(tmp_path: Path) -> Path:
    path = tmp_path / "gateway.sqlite"
    with closing(sqlite3.connect(path)) as connection:
        connection.executescript(DUMP.read_text(encoding="utf-8"))
    return path


@pytest.fixture
def history(database: Path) -> Iterator[History]:
    with History(database) as found:
        yield found


def assert_same_bits(found: FloatArray | None, wanted: object) -> None:
    assert found is not None
    assert found.tobytes() == np.asarray(wanted, dtype="<f8").tobytes()


def assert_same(found: Decision, wanted: Decision) -> None:
    for name in ("predicted", "corrected", "sigma", "limits"):
        assert_same_bits(getattr(found, name), getattr(wanted, name))
    assert (found.k, found.phase, found.measure, found.events) == (
        wanted.k,
        wanted.phase,
        wanted.measure,
        wanted.events,
    )


def test_steps_with_measurement_decision_and_models(history: History) -> None:
    first, second = history.steps()
    for found, frame in ((first, example.FRAME), (second, example.MEASURED_FRAME)):
        assert found.frame.k == frame.k
        assert_same_bits(found.frame.inputs, frame.inputs)
        assert found.frame.valid.tolist() == frame.valid.tolist()
    assert first.frame.measurement is None
    assert second.frame.measurement is not None
    assert_same_bits(second.frame.measurement.errors, example.MEASUREMENT.errors)
    assert_same_bits(second.frame.measurement.sigma, example.MEASUREMENT.sigma)
    assert_same(first.decision, example.DECISION)
    assert_same(second.decision, SECOND)
    assert [m.fingerprint() for m in first.adopted] == [example.MODELS.fingerprint()]
    assert second.adopted == ()


def test_measurements_events_compensation_and_what_ran(history: History, database: Path) -> None:
    measured, by_pose, refused = history.measurements()
    assert (measured.number, measured.why, measured.ended) == (41, "calibration", example.LATER)
    assert_same_bits(measured.centres_mm, np.zeros((6, 3)))
    assert_same_bits(measured.errors, example.NINE)
    assert by_pose.in_force_um.tolist() == [[0.0, 1.0, 2.0], [3.0, 4.0, 5.5]]
    assert (refused.errors, refused.reason) == (None, "refused: alarm 21612")
    assert [(k, e.kind, e.text, e.error, e.limit) for _, k, e in history.events()] == [
        (k, e.kind, e.text, e.error, e.limit)
        for k, e in ((None, example.PROBLEM), (7, example.LIMIT), (7, example.NO_NUMBER))
    ]
    written, advised = history.compensation()
    assert (written.time, written.mode, written.source, written.written) == (
        example.NOW, "compensate", "prediction", True,
    )  # fmt: skip
    assert_same_bits(written.offsets_um, example.WRITE.step.offsets_um)
    assert not advised.written
    assert history.channel_health() == {"bed_front": {"good": 1}, "Öl": {"sensor_fault": 1}}
    assert history.config() == ('{"machine": {"name": "mill"}}', "the hash", "the versions")
    assert applied(database) == [(EPOCH, "the hash")]
    assert history.last_number() == 41


async def test_it_is_continued(database: Path) -> None:
    with Store(database, "boot-2", SteppedClock()) as store:
        store.record(FrameMade(replace(example.FRAME, k=9)))
        store.record(DecisionMade(replace(example.DECISION, k=9)))
        store.record(ProbingRequested(44))
        await store.on_disk()
        with History(database) as history:
            assert history.last_number() == 44
    with History(database) as history:
        assert [step.frame.k for step in history.steps()] == [7, 8, 9]
