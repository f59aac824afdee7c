"""Where everything that happens goes: the store, the telemetry, the view. Each is told and returns at once."""

from collections.abc import Sequence
from typing import Protocol

from drivers.base import Reading
from gateway.nc.slew import Write
from gateway.probing.cycle import Outcome
from gateway.probing.schedule import Outlook
from talc.frame import Decision, Event, Frame
from talc.models import ModelSet
from talc.sensor_check import Judgement


class Outlet(Protocol):
    """Told of everything, in the order in which it happens, from the event loop's thread."""

    def readings(self, readings: Sequence[Reading]) -> None: ...

    def frame(self, frame: Frame) -> None: ...

    def decision(self, decision: Decision) -> None: ...

    def requested(self, number: int) -> None:
        """A probing cycle is about to be asked for under this number. Returns when it will not be forgotten."""
        ...

    def measurement(self, outcome: Outcome) -> None: ...

    def models(self, models: ModelSet, after_k: int) -> None:
        """Models adopted after the step with index `after_k`; they act from the next step on."""
        ...

    def event(self, event: Event, k: int | None) -> None: ...

    def compensation(self, write: Write) -> None: ...

    def probing(self, outlook: Outlook) -> None:
        """Where the wish for a measurement stands, when that changes."""
        ...

    def sensors(self, judgement: Judgement, k: int) -> None:
        """What the sensors say of each other after the step with index `k`."""
        ...


class Fanout:
    """Hands everything to several outlets, in order: what is stored first is what is published next."""

    def __init__(self, outlets: Sequence[Outlet]) -> None:
        self._outlets = tuple(outlets)

    def readings(self, readings: Sequence[Reading]) -> None:
        for outlet in self._outlets:
            outlet.readings(readings)

    def frame(self, frame: Frame) -> None:
        for outlet in self._outlets:
            outlet.frame(frame)

    def decision(self, decision: Decision) -> None:
        for outlet in self._outlets:
            outlet.decision(decision)

    def requested(self, number: int) -> None:
        for outlet in self._outlets:
            outlet.requested(number)

    def measurement(self, outcome: Outcome) -> None:
        for outlet in self._outlets:
            outlet.measurement(outcome)

    def models(self, models: ModelSet, after_k: int) -> None:
        for outlet in self._outlets:
            outlet.models(models, after_k)

    def event(self, event: Event, k: int | None) -> None:
        for outlet in self._outlets:
            outlet.event(event, k)

    def compensation(self, write: Write) -> None:
        for outlet in self._outlets:
            outlet.compensation(write)

    def probing(self, outlook: Outlook) -> None:
        for outlet in self._outlets:
            outlet.probing(outlook)

    def sensors(self, judgement: Judgement, k: int) -> None:
        for outlet in self._outlets:
            outlet.sensors(judgement, k)
