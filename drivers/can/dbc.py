"""Reads a CAN device that sends without being asked, described by a DBC file."""

from collections.abc import Mapping, Sequence
from time import monotonic

from drivers.base import Clock, Quality, Reading
from drivers.can.bus import CanBus, KeptFrame
from drivers.can.dbc_profile import CanDbcProfile, DbcSignal
from drivers.can.wanted import WantedFrame
from drivers.faults import Fault
from drivers.readings import ReadingMaker
from drivers.text import Text


class CanDbcDevice:
    """A device that sends without being asked; `channels` maps names to the profile's signals, counted from 0."""

    def __init__(
        self, device: str, bus: CanBus, profile: CanDbcProfile, channels: Mapping[str, int], clock: Clock
    ) -> None:
        self.device, self.channels = device, tuple(channels)
        self._bus = bus
        self._signals = {name: profile.signals[number] for name, number in channels.items()}
        self._frames = {signal.frame for signal in self._signals.values()}
        self._maker = ReadingMaker(dict.fromkeys(channels, profile.unit), clock)
        bus.want(self._frames)

    async def connect(self) -> None:
        """Check that frames arrive. Raises the bus's errors."""
        await self._bus.latest(self.device, self._frames)

    async def read(self, *, again: bool = False) -> Sequence[Reading]:  # noqa: ARG002
        """One reading per channel, as old as its frame. A missing message affects its own channels only."""
        heard, signals = await self._bus.latest(self.device, self._frames), self._signals
        now_s = monotonic()
        ages_s = {name: now_s - heard[s.frame].came_s if s.frame in heard else 0.0 for name, s in signals.items()}
        return self._maker.make({name: _value(signal, heard) for name, signal in signals.items()}, ages_s)

    async def close(self) -> None:
        """Nothing to close: the device holds no resources."""


def _value(signal: DbcSignal, heard: Mapping[WantedFrame, KeptFrame]) -> float | Fault:
    kept = heard.get(signal.frame)
    if kept is None:
        message, identifier = signal.message.name, signal.frame.identifier
        what = Text("can_no_message", message=message, identifier=identifier)
        if signal.frame.pages:
            what = Text("can_no_page", message=message, identifier=identifier, signal=signal.signal.name)
        return Fault(Quality.COMM_FAULT, what)
    return signal.decode(kept.data)
