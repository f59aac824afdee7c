"""A problem that began or ended, and the events that report something in words."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

from gateway.model.codes import NoticeCode
from gateway.model.text import Text, Value
from talc.frame import Event
from talc.kinds import EventKind
from talc.sensor_check import Finding


@dataclass(frozen=True, slots=True)
class Notice:
    """A problem that began or ended. Reported once each."""

    subject: str
    """What has it: `bus rtu1`, `period of bus rtu1`, `device rtd1`, `channel bed_front_left`, `NC`. It stays the same
    from its beginning to its end."""
    text: Text
    ended: bool = False
    at_s: float = field(default=0.0, compare=False)
    """On the clock of whoever reports it, monotonic seconds."""

    @property
    def code(self) -> str:
        """Of NoticeCode."""
        return self.text.code

    @property
    def values(self) -> Mapping[str, Value]:
        """By name."""
        return self.text.values


Notify = Callable[[Notice], None]


def event_of(kind: EventKind, text: Text, value: float | None = None) -> Event:
    """An event of the service."""
    return Event(kind, text, value=value, code=text.code, values=text.values)


def problem_event(notice: Notice) -> Event:
    """A problem that began or ended, as an event; its values have the subject too."""
    kind = EventKind.PROBLEM_ENDED if notice.ended else EventKind.PROBLEM
    return replace(event_of(kind, notice.text), values={"subject": notice.subject, **notice.values})


def worded(event: Event) -> Event:
    """An event of the controller, in words."""
    return replace(event, text=Text(event.code, **event.values)) if event.code and not event.text else event


def finding_text(finding: Finding) -> Text:
    """What the comparison of the sensors has found."""
    if finding.kind == "swap":
        return Text(NoticeCode.SENSORS_EXCHANGED, one=finding.inputs[0], other=finding.inputs[1])
    names = " or ".join((*finding.inputs, *finding.alternatives))
    return Text(NoticeCode.SENSOR_OFF, names=names, offset_K=finding.offset_K)
