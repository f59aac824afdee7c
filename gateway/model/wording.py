"""Events in words: what the controller and the service report, as a text for people."""

from collections.abc import Sequence
from dataclasses import replace

from gateway.model.codes import NoticeCode
from gateway.model.notice import Notice
from gateway.model.text import Text
from talc.frame import Event
from talc.kinds import EventKind


def event_of(kind: EventKind, text: Text, value: float | None = None) -> Event:
    """An event of the service."""
    return Event(kind, text, value=value, code=text.code, values=text.values)


def problem_event(notice: Notice) -> Event:
    """A notice as an event; a problem's values have the subject too."""
    if notice.is_fact:
        return event_of(EventKind.OPERATOR, notice.text)
    kind = EventKind.PROBLEM_ENDED if notice.ended else EventKind.PROBLEM
    return replace(event_of(kind, notice.text), values={"subject": notice.subject, **notice.values})


def worded(event: Event) -> Event:
    """An event of the controller, in words."""
    return replace(event, text=Text(event.code, **event.values)) if event.code and not event.text else event


def finding_text(
    kind: str,
    inputs: Sequence[str],
    offset_K: float,
    alternatives: Sequence[str] = (),
) -> Text:
    """What the comparison of the sensors has found; see talc.sensor_check.Finding."""
    if kind == "swap":
        return Text(NoticeCode.SENSORS_EXCHANGED, one=inputs[0], other=inputs[1])
    return Text(NoticeCode.SENSOR_OFF, names=" or ".join((*inputs, *alternatives)), offset_K=offset_K)
