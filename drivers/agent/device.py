"""Values that a control has itself, as the channels of a device: on LinuxCNC its HAL pins, signals and parameters."""

import math
from collections.abc import Mapping, Sequence

from drivers.agent.bus import AgentBus
from drivers.agent.profile import AgentProfile, AgentValue
from drivers.base import Clock, Quality, Reading, WrongDevice
from drivers.faults import Fault
from drivers.readings import ReadingMaker
from drivers.text import Text

_ABSENT = Text("agent_compare_name")


class AgentDevice:
    """Some values of a control; `channels` maps names to the profile's values, counted from 0."""

    def __init__(
        self, device: str, bus: AgentBus, profile: AgentProfile, channels: Mapping[str, int], clock: Clock
    ) -> None:
        self.device, self.channels = device, tuple(channels)
        self._bus, self._profile, self._clock = bus, profile, clock
        self._channels = {name: profile.values[number] for name, number in channels.items()}
        self._names = tuple(dict.fromkeys(name for value in self._channels.values() for name in value.names))
        self._maker = ReadingMaker({name: v.unit or profile.unit for name, v in self._channels.items()}, clock)
        self._moved: dict[str, _Moved] = {v.alive: _Moved() for v in self._channels.values() if v.alive is not None}

    async def connect(self) -> None:
        """Check that the control has at least one of the values. Raises WrongDevice, or the bus's errors."""
        names = [value.name for value in self._channels.values()]
        told = await self._bus.values(self.device, names)
        if all(value is None for value in told.values):
            raise WrongDevice(
                Text("agent_nothing_named", names=", ".join(names[:3])),
                bus=self._bus.name,
                device=self.device,
                hint=_ABSENT,
            )

    async def read(self, *, again: bool = False) -> Sequence[Reading]:  # noqa: ARG002
        """One reading per channel. A name that the control does not have affects its own channel only."""
        told = await self._bus.values(self.device, self._names)
        found, now_s = dict(zip(self._names, told.values, strict=True)), self._clock.monotonic()
        for name, moved in self._moved.items():
            moved.see(found[name], now_s)
        judged = {name: self._judged(value, found, now_s) for name, value in self._channels.items()}
        if told.stale:
            judged = {name: _or_stale(value, told.stale) for name, value in judged.items()}
        return self._maker.make(judged)

    async def close(self) -> None:
        """Nothing to close: the connection is the bus's."""

    def _judged(self, value: AgentValue, found: Mapping[str, float | str | None], now_s: float) -> float | Fault:
        for name in value.names:
            if found[name] is None:
                return Fault(Quality.COMM_FAULT, Text("agent_nothing_named_so", name=name, hint=_ABSENT))
        numbers = {name: number for name in value.names if isinstance(number := found[name], float)}
        for name in value.names:
            if name not in numbers:
                return Fault(Quality.SENSOR_FAULT, Text("holds_no_number", name=name, found=found[name]))
        if value.valid is not None and not numbers[value.valid]:
            return Fault(Quality.SENSOR_FAULT, Text("agent_not_valid", valid=value.valid))
        if value.error is not None and numbers[value.error]:
            return Fault(Quality.SENSOR_FAULT, Text("agent_error_set", name=value.error, number=numbers[value.error]))
        if value.alive is not None:
            quiet_s = now_s - self._moved[value.alive].at_s
            if quiet_s > (self._profile.max_age_s or 0.0):
                since = Text("agent_for_s", quiet_s=quiet_s) if math.isfinite(quiet_s) else Text("agent_since_start")
                return Fault(Quality.STALE, Text("agent_unchanged", alive=value.alive, since=since))
        return value.value(numbers[value.name])


class _Moved:
    """When a value that shows whether its source lives last changed."""

    def __init__(self) -> None:
        self.at_s = -math.inf
        self._last: float | str | None = None

    def see(self, now: float | str | None, now_s: float) -> None:
        if isinstance(now, float) and isinstance(self._last, float) and now != self._last:
            self.at_s = now_s
        self._last = now


def _or_stale(value: float | Fault, why: str) -> float | Fault:
    return value if isinstance(value, Fault) else Fault(Quality.STALE, why)
