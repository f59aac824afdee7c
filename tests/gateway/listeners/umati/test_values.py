"""The nodes never show an old value that looks fresh, nor a value of a gateway that is gone."""

from datetime import timedelta

import pytest

from gateway.listeners.umati.values import NodeShown, shown_now
from tests.benches.heard import BEGAN, STEP, HeardMachine

ERROR = ("ThermalErrors", "EX0C")
TIME = ("Next", "PredictedTime")


def decided() -> HeardMachine:
    """Two steps with 12.5 and 13.5 µm, and the learner's reasons."""
    machine = HeardMachine()
    machine.decision(1, {"EX0C": 12.5})
    machine.passes(STEP)
    machine.decision(2, {"EX0C": 13.5})
    machine.reasons(2)
    return machine


def shown(machine: HeardMachine, path: tuple[str, str]) -> NodeShown:
    return shown_now(machine.seen, machine.now_s)[path]


def test_a_value_bears_the_time_at_which_it_was_taken() -> None:
    assert shown(decided(), ERROR) == NodeShown(13.5, "Good", BEGAN + STEP)


def test_before_anything_is_heard_nothing_is_shown() -> None:
    for machine, status in ((HeardMachine(), "BadNoData"), (HeardMachine(alive=False), "BadNoCommunication")):
        values = shown_now(machine.seen, machine.now_s)
        assert len(values) == 31
        assert {(each.value, each.status) for path, each in values.items() if path[0] != "Offsets"} == {(None, status)}


def test_an_estimate_of_more_than_a_quarter_of_an_hour_is_uncertain_though_the_gateway_speaks() -> None:
    machine = decided()
    machine.passes(timedelta(seconds=900))
    machine.status()
    assert shown(machine, ERROR).status == "Good"
    machine.passes(timedelta(seconds=10))
    machine.status()
    assert shown(machine, ERROR) == NodeShown(13.5, "UncertainLastUsableValue", BEGAN + STEP)


def test_a_gateway_that_says_nothing_for_a_minute_has_no_good_value() -> None:
    machine = decided()
    machine.reading("bed")
    machine.passes(timedelta(seconds=60))
    assert shown(machine, ("Channels", "bed")).status == "Good"
    machine.passes(timedelta(seconds=1))
    assert "Good" not in {each.status for each in shown_now(machine.seen, machine.now_s).values()}
    assert shown(machine, ("Channels", "bed")) == NodeShown(21.5, "UncertainLastUsableValue", BEGAN + STEP)


def test_nothing_of_a_gateway_that_is_gone_has_a_value() -> None:
    machine = decided()
    machine.reading("bed")
    machine.seen.disappear(machine.now)
    values = shown_now(machine.seen, machine.now_s)
    assert ("Channels", "bed") in values
    assert set(values.values()) == {NodeShown(None, "BadNoCommunication", None)}


def test_after_a_restart_only_what_was_heard_again_counts() -> None:
    machine = decided()
    machine.reading("bed")
    machine.seen.disappear(machine.now)
    machine.seen.appear(machine.now)
    values = shown_now(machine.seen, machine.now_s)
    assert values[ERROR].status == "BadNoData"
    assert ("Channels", "bed") not in values


@pytest.mark.parametrize(
    ("quality", "value", "status"),
    [
        ("good", 21.5, "Good"),
        ("stale", 21.5, "UncertainLastUsableValue"),
        ("comm_fault", None, "BadNoCommunication"),
        ("sensor_fault", 21.5, "BadSensorFailure"),
        ("out_of_range", 400.0, "BadOutOfRange"),
        ("of a later version", 21.5, "BadNoData"),
        ("good", None, "BadNoData"),
    ],
)
def test_a_reading_has_the_status_of_its_quality(quality: str, value: float | None, status: str) -> None:
    machine = HeardMachine()
    machine.reading("bed", value, quality)
    found = shown(machine, ("Channels", "bed"))
    assert found.status == status
    assert found.value == (None if status.startswith("Bad") else value)


def test_the_next_cycle_is_predicted_until_its_time_and_uncertain_after_it() -> None:
    machine = decided()
    assert shown(machine, TIME) == NodeShown(BEGAN + 13 * STEP, "Good", BEGAN + STEP)  # 12 steps ahead
    machine.passes(12 * STEP)
    machine.decision(14)
    assert shown(machine, TIME).status == "Good"
    machine.passes(timedelta(seconds=1))
    machine.status()
    assert shown(machine, TIME).status == "UncertainLastUsableValue"


def test_offsets_that_the_control_has_not_taken_are_not_known() -> None:
    machine = decided()
    machine.compensation((1.0, 2.0, 3.0), written=False)
    assert shown(machine, ("Offsets", "X")).status == "BadNoData"
    machine.compensation((1.0, 2.0, 3.0))
    assert shown(machine, ("Offsets", "X")).value == 1.0
