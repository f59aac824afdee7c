"""The phase of a method: a change is an event, and measurements count from the last beginning."""

from talc.frame import Event
from talc.kinds import EventCode, EventKind, Phase
from talc.stage import Stage


def test_a_change_of_phase_is_an_event_and_counts_again() -> None:
    stage, events = Stage(), list[Event]()
    assert stage.phase is Phase.CALIBRATION
    stage.measured = 7
    stage.enter(Phase.COMPENSATION, events)
    assert (stage.phase, stage.measured) == (Phase.COMPENSATION, 0)
    values = {"phase": Phase.CALIBRATION.value, "next": Phase.COMPENSATION.value}
    assert events == [Event(EventKind.PHASE_CHANGED, code=EventCode.PHASE_CHANGED, values=values)]


def test_the_same_phase_begins_again_without_an_event() -> None:
    stage, events = Stage(measured=7), list[Event]()
    stage.enter(Phase.CALIBRATION, events, measured=2)
    assert (stage.measured, events) == (2, [])
