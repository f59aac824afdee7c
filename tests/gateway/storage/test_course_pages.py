"""Estimates and measurements of a span, thinned, from a database that a gateway has written."""

import json
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from gateway.model.events import DecisionMade, EventReported, FrameMade, MeasurementEnded, ReadingsTaken, ReasonsGiven
from gateway.storage.course_pages import course_between
from gateway.storage.faults import StoreError
from gateway.storage.store import Store
from talc.frame import Event, EventKind, Frame, Measurement
from tests.benches import telemetry_examples as example
from tests.benches.stepped_clock import EPOCH, SteppedClock

STEP_S = 300.0
STEPS = 1000


def at(k: float) -> datetime:
    return datetime.fromtimestamp(k * STEP_S, UTC)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Steps 0 to 399 and 600 to 999, in between it was off; an estimate is its index, and each 100th is measured."""
    file = tmp_path_factory.mktemp("store") / "g.sqlite"
    with Store(file, "boot-1", SteppedClock()) as store:
        for k in (*range(400), *range(600, STEPS)):
            store.record(FrameMade(replace(example.FRAME, k=k)))
            store.record(DecisionMade(replace(example.DECISION, k=k, corrected=np.full(9, float(k)))))
            if k % 100 == 0:
                found = Measurement(np.full(9, k + 0.5), np.full(9, 0.25))
                store.record(MeasurementEnded(replace(example.OUTCOME, ended=at(k), measurement=found)))
        store.record(MeasurementEnded(replace(example.REFUSED, ended=at(350))))
        for kind in (EventKind.PROBLEM, EventKind.PROBLEM_ENDED, EventKind.OPERATOR):
            store.record(EventReported(Event(kind, "text"), None))
    return file


def test_a_short_span_has_every_estimate_from_its_begin_on_and_before_its_end(path: Path) -> None:
    found = course_between(path, at(99.5), at(110), 100, STEP_S)
    assert found.time.tolist() == [k * STEP_S for k in range(100, 110)]
    assert found.corrected[:, 0].tolist() == [float(k) for k in range(100, 110)]
    assert found.sigma[0].tolist() == pytest.approx(np.abs(example.NINE).tolist(), nan_ok=True)
    assert (found.measured_time.tolist(), found.measured[0, 0]) == ([100 * STEP_S], 100.5)
    assert found.measured_sigma[0, 0] == 0.25
    assert found.residual_um.tolist() == [example.OUTCOME.residual_um]


@pytest.mark.parametrize("most", [1, 7, 50, 400])
def test_a_long_span_is_thinned_to_as_many_and_time_off_stays_empty(path: Path, most: int) -> None:
    found = course_between(path, at(0), at(STEPS), most, STEP_S)
    k = found.time / STEP_S
    part = -(-STEPS // most)
    assert len(k) <= most
    assert (np.diff(k) > 0).all()
    assert set(k // part) == {i // part for i in (*range(400), *range(600, STEPS))}, "one of each part that has any"
    assert not ((k >= 400) & (k < 600)).any()
    assert len(found.measured_time) <= max(most, 1)


def test_a_refused_cycle_is_no_measurement_and_thinned_ones_are_first_and_last(path: Path) -> None:
    everything = course_between(path, at(0), at(STEPS), 100, STEP_S)
    assert (everything.measured_time / STEP_S).tolist() == [0, 100, 200, 300, 600, 700, 800, 900]
    few = course_between(path, at(0), at(STEPS), 2, STEP_S)
    assert (few.measured_time / STEP_S).tolist() == [0, 900]


def test_problems_and_orders_of_the_span_are_told_with_their_time(path: Path) -> None:
    found = course_between(path, EPOCH, EPOCH + timedelta(seconds=1), 10, STEP_S)
    assert found.marked == ((EPOCH.timestamp(), "problem"), (EPOCH.timestamp(), "operator"))
    assert course_between(path, EPOCH - timedelta(days=1), EPOCH, 10, STEP_S).marked == ()


def test_a_span_without_anything_is_empty_and_a_year_costs_no_more_than_its_parts(path: Path) -> None:
    assert course_between(path, at(5000), at(6000), 10, STEP_S).corrected.shape == (0, 9)
    year = course_between(path, at(0) - timedelta(days=200), at(0) + timedelta(days=200), 500, STEP_S)
    assert 1 <= len(year.time) <= 500


def test_temperatures_are_those_of_the_same_steps_under_their_names_of_today(tmp_path: Path) -> None:
    """The inputs change places between two runs; one is no temperature; a value that is not good is unknown."""
    file, clock = tmp_path / "g.sqlite", SteppedClock()
    height = {"bed": 100.0, "spindle": 200.0, "growth": 300.0}
    for boot, names, ks in (
        ("boot-1", ("bed", "growth", "spindle"), range(10)),
        ("boot-2", ("spindle", "bed", "growth"), range(10, 20)),
    ):
        with Store(file, boot, clock) as store:
            store.begin(json.dumps({"device": [{"channels": names}]}), "fingerprint", "versions")
            units = {"bed": "degC", "spindle": "degC", "growth": "um"}
            store.record(ReadingsTaken([replace(example.READING, channel=n, unit=units[n]) for n in names]))
            for k in ks:
                inputs, good = np.array([height[n] + k for n in names]), np.array([(n, k) != ("bed", 5) for n in names])
                store.record(FrameMade(Frame(k, inputs, good)))
                store.record(DecisionMade(replace(example.DECISION, k=k)))
    found = course_between(file, at(0), at(20), 100, STEP_S, temperatures=True, inputs=True)
    assert found.temperature_names == ("spindle", "bed")
    expected = np.array([[200.0 + k, 100.0 + k] for k in range(20)])
    expected[5, 1] = np.nan
    np.testing.assert_array_equal(found.temperatures, expected)
    assert (found.other_names, found.others[:, 0].tolist()) == (("growth",), [300.0 + k for k in range(20)])
    assert course_between(file, at(0), at(20), 100, STEP_S).temperatures.shape == (20, 0)


def test_what_a_measurement_finds_beyond_the_correction_is_told_as_left(tmp_path: Path) -> None:
    """At step 4 nothing is in force yet; at 6 what was predicted is, and at 8 no step took the measurement over."""
    file, found = tmp_path / "g.sqlite", Measurement(np.full(9, 7.0), np.full(9, 0.25))
    with Store(file, "boot-1", SteppedClock()) as store:
        for k in range(8):
            store.record(FrameMade(Frame(k, np.ones(3), np.ones(3, np.bool_), found if k in (4, 6) else None)))
            store.record(DecisionMade(replace(example.DECISION, k=k, predicted=np.full(9, 5.0))))
        for k, in_force in ((4, 0.0), (6, 1.0), (8, 1.0)):
            outcome = replace(example.OUTCOME, ended=at(k - 0.5), measurement=found, in_force_um=(in_force,) * 3)
            store.record(MeasurementEnded(outcome))
    left = course_between(file, at(0), at(20), 100, STEP_S).left[:, 0].tolist()
    assert left == pytest.approx([7.0, 2.0, np.nan], nan_ok=True)


def test_a_database_that_is_not_there_says_so(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match=r"none\.sqlite"):
        course_between(tmp_path / "none.sqlite", at(0), at(1), 10, STEP_S)


def test_the_latest_reasons_of_a_span_come_with_what_was_known_then(tmp_path: Path) -> None:
    file, clock = tmp_path / "g.sqlite", SteppedClock()
    with Store(file, "boot-1", clock) as store:
        begin = int(clock.utc().timestamp() // STEP_S)
        for i in range(10):
            if i == 5:
                found = Measurement(np.zeros(9), np.ones(9))
                store.record(MeasurementEnded(replace(example.OUTCOME, ended=clock.utc(), measurement=found)))
            store.record(DecisionMade(replace(example.DECISION, k=begin + i, sigma=np.full(9, float(i)))))
            store.record(ReasonsGiven(replace(example.REASONS, k=begin + i)))
            clock.spend(STEP_S)
    span = at(begin), at(begin + 8)
    found_few = course_between(file, *span, 3, STEP_S, reasons=True).reasons
    assert [each.reasons.k - begin for each in found_few] == [5, 6, 7]
    assert [each.sigma[0] for each in found_few] == [5.0, 6.0, 7.0]
    assert {each.measured for each in found_few} == {at(begin + 5)}
    everything = course_between(file, *span, 100, STEP_S, reasons=True).reasons
    assert [each.reasons.k - begin for each in everything] == list(range(8))
    assert [each.measured is None for each in everything] == [True] * 5 + [False] * 3
    assert everything[0].reasons.errors[0].inputs == example.REASONS.errors[0].inputs
    assert course_between(file, *span, 100, STEP_S).reasons == ()
