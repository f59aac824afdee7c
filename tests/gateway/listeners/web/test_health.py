"""How the gateway itself is, and whether what is in force follows the estimate: samples in, rows out."""

from typing import Any

import pytest
from msgspec.structs import replace

from gateway.listeners.web import parts
from gateway.listeners.web.at_tool import WorkPoint
from gateway.listeners.web.sentences import Amount, SaidRow, ToldName
from gateway.listeners.web.verdict import Viewpoint, verdict_of
from gateway.listeners.web.view import view
from gateway.model.control_state import NcState
from gateway.telemetry.messages import StatusMessage, StorageStanding
from tests.benches.heard import HeardMachine

MATRIX = WorkPoint(150.0, 0.0, 80.0).matrix(0.15)
WITHIN = Viewpoint(MATRIX, 10.0)


def rows(**status: Any) -> dict[str, SaidRow]:
    """The rows of a gateway that publishes these fields in its status."""
    heard = HeardMachine()
    fields: dict[str, Any] = {"readings_dropped": 0, "periods_missed": {}, "config": None, "probing": None} | status
    heard.hear("status", StatusMessage(*heard.stamp(), phase="compensation", k=0, **fields))
    return {row.label: row for row in parts.health(heard.seen)}


@pytest.mark.parametrize("state", NcState)
def test_a_control_that_cannot_be_used_is_marked(state: NcState) -> None:
    marks = {NcState.READY: "good", NcState.PROBING: "good", NcState.NONE: ""}
    assert rows(nc=state.value)["label.nc"].mark == marks.get(state, "notice")


@pytest.mark.parametrize(("kept", "said", "mark"), [(True, "clock.kept", "good"), (False, "clock.free", "notice")])
def test_a_clock_that_nothing_keeps_is_marked(kept: bool, said: str, mark: str) -> None:
    clock = rows(clock_synchronised=kept)["label.clock"]
    assert (clock.said.say, clock.mark) == (said, mark)


def test_a_store_with_a_problem_says_which_and_how_much_waits() -> None:
    store = rows(storage=StorageStanding("disk full", 12, 0, 3.0))["label.store"]
    assert store.mark == "bad"
    assert store.said.values == {"text": ToldName("disk full"), "n": Amount(12, d=0)}
    assert rows(storage=StorageStanding("", 0, 0, 900.0))["label.store"].mark == "good"


@pytest.mark.parametrize(
    ("storage", "say", "mark"),
    [
        (StorageStanding("", 0, 0, 900.0), "spool.empty", ""),
        (StorageStanding("", 30, 0, 900.0, 0.7), "spool.oldest", ""),
        (StorageStanding("", 30, 0, 900.0), "spool.waiting", ""),  # of an earlier program
        (StorageStanding("disk full", 4000, 0, 0.0, 130.0), "spool.oldest", "notice"),
        (StorageStanding("disk full", 4000, 12, 0.0, 130.0), "spool.dropped", "notice"),
        (StorageStanding("", 0, 12, 900.0), "spool.dropped", "notice"),  # the store works again
    ],
)
def test_what_is_not_stored_yet_is_shown_with_its_age(storage: StorageStanding, say: str, mark: str) -> None:
    spool = rows(storage=storage)["label.spool"]
    assert (spool.said.say, spool.mark) == (say, mark)
    if say == "spool.oldest":
        assert (spool.said.values["n"], spool.said.values["oldest"]) == (
            Amount(storage.waiting, d=0),
            Amount(storage.oldest_s, "s", d=0),
        )


def test_messages_that_were_dropped_are_counted_of_both_kinds() -> None:
    dropped = rows(readings_dropped=3, messages_dropped=4)["label.dropped"]
    assert (dropped.said.values["n"], dropped.mark) == (Amount(7, d=0), "notice")
    assert "label.dropped" not in rows()


@pytest.mark.parametrize(
    ("mode", "source", "written", "mark", "notes"),
    [
        ("compensate", "prediction", True, "good", []),
        ("compensate", "stale", True, "notice", ["tool.not_following"]),
        ("compensate", "prediction", False, "notice", ["tool.not_following"]),
        ("advise", "prediction", False, "notice", ["tool.not_written"]),
    ],
)
def test_a_control_that_does_not_follow_the_estimate_is_said(
    mode: str, source: str, written: bool, mark: str, notes: list[str]
) -> None:
    heard = HeardMachine()
    heard.compensation(mode=mode, source=source, written=written)
    heard.decision()
    found = {row.label: row for row in parts.health(heard.seen)}
    assert found["label.control"].mark == mark
    assert [note.say for note in view(heard.seen, WITHIN, heard.now_s).tool_notes] == notes
    heard.seen.alive = False
    assert view(heard.seen, WITHIN, heard.now_s).tool_notes == (), "nothing is known of a gateway that is gone"


def test_nothing_is_said_about_the_control_of_a_gateway_that_was_never_heard() -> None:
    assert view(HeardMachine(alive=False).seen, WITHIN, 0.0).tool_notes == ()


def test_what_moves_an_error_is_named_the_four_largest_of_those_that_are_not_written_as_zero() -> None:
    heard = HeardMachine()
    heard.reasons()
    assert heard.seen.reasons is not None
    heard.seen.reasons.errors["EZ0A"].inputs.update({"a": 0.04, "b": 0.06, "c": 0.5, "d": -0.7})
    (driven,) = [each for each in parts.driven(heard.seen) if each.error == "EZ0A"]
    assert [name for name, _ in driven.movers] == ["spindle_rear", "bed", "d", "c"]
    heard.seen.reasons.errors["EZ0A"].inputs.clear()
    heard.seen.reasons.errors["EZ0A"].inputs.update({"a": 0.04, "b": -0.06})
    (driven,) = [each for each in parts.driven(heard.seen) if each.error == "EZ0A"]
    assert [name for name, _ in driven.movers] == ["b"]


def test_the_axis_that_is_said_is_the_one_whose_far_end_is_farthest() -> None:
    """40 µm are left in Z; Y is known least."""
    heard = HeardMachine()
    heard.compensation(mode="advise", written=False)
    heard.decision(corrected={"EZ0A": 40.0}, sigma={"EY0C": 5.0})
    (said,) = verdict_of(heard.seen, WITHIN, heard.now_s).because
    assert str(said.values["axis"]) == "Word(w='Z')"


def test_a_value_that_was_replaced_is_doubtful() -> None:
    heard = HeardMachine()
    heard.decision()
    assert list(parts.doubts(heard.seen)) == []
    assert heard.seen.decision is not None
    heard.hear("decision", replace(heard.seen.decision, seq=2, substituted=("bed_rear", "z_nut")))
    (doubt,) = parts.doubts(heard.seen)
    assert (doubt.say, doubt.values["names"]) == ("doubt.substituted", ToldName("bed_rear, z_nut"))
