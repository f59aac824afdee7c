"""Nodes of an OPC UA server as the channels of a device."""

import struct
from collections.abc import Mapping, Sequence
from datetime import datetime

from drivers.base import Clock, Quality, Reading, WrongDevice
from drivers.faults import Fault
from drivers.number_types import WRITTEN_NUMBER
from drivers.opcua.bus import OpcUaBus
from drivers.opcua.nodes import NodeValue
from drivers.opcua.profile import OpcUaNode, OpcUaProfile
from drivers.readings import ReadingMaker
from drivers.text import Text, shown


class OpcUaDevice:
    """Some nodes of a server; `channels` maps names to the profile's nodes, counted from 0."""

    def __init__(
        self, device: str, bus: OpcUaBus, profile: OpcUaProfile, channels: Mapping[str, int], clock: Clock
    ) -> None:
        self.device, self.channels = device, tuple(channels)
        self._bus, self._profile, self._clock = bus, profile, clock
        self._nodes = {name: profile.nodes[number] for name, number in channels.items()}
        self._names = tuple(profile.names[number] for number in channels.values())
        self._measured: dict[str, tuple[datetime, float]] = {}
        """Source time of each channel's latest value, and when that was by this computer's monotonic clock."""
        self._maker = ReadingMaker({name: node.unit or profile.unit for name, node in self._nodes.items()}, clock)

    async def connect(self) -> None:
        """Check that the server has at least one of the nodes. Raises WrongDevice, or the bus's errors."""
        values = await self._ask()
        if all(value.is_unknown for value in values):
            raise WrongDevice(
                Text("opcua_no_nodes", names=", ".join(map(str, self._names[:3]))),
                bus=self._bus.name,
                device=self.device,
                hint=values[0].detail or Text("opcua_compare_ids"),
            )

    async def read(self, *, again: bool = False) -> Sequence[Reading]:
        """One reading per channel; with `max_age_s` each is as old as its source timestamp says. A node that cannot be
        read affects its own channel only."""
        found, now_s = dict(zip(self._nodes, await self._ask(again=again), strict=True)), self._clock.monotonic()
        return self._maker.make_aged({name: self._judged(name, value, now_s) for name, value in found.items()})

    async def close(self) -> None:
        """Nothing to close: the session is the bus's."""

    async def _ask(self, *, again: bool = False) -> list[NodeValue]:
        aged = self._profile.max_age_s is not None
        return await self._bus.read(self.device, self._names, aged=aged, again=again)

    def _judged(self, channel: str, found: NodeValue, now_s: float) -> tuple[float | Fault, float]:
        """The value and its age, s."""
        fault = found.fault()
        if fault is not None:
            return fault, 0.0
        age_s = self._age_s(channel, found, now_s)
        return self._too_old(found, age_s) or self._value(self._nodes[channel], found), age_s

    def _age_s(self, channel: str, found: NodeValue, now_s: float) -> float:
        """By the server's clock, and at least the time since the same source time was first seen: a server's clock may
        go in steps of a second, or be set. 0 if ages are not looked up."""
        if found.source_time is None or found.age_s is None:
            return 0.0
        measured_s = now_s - max(0.0, found.age_s)
        source_time, before_s = self._measured.get(channel, (None, measured_s))
        if source_time == found.source_time:
            measured_s = min(measured_s, before_s)
        self._measured[channel] = found.source_time, measured_s
        return now_s - measured_s

    def _value(self, node: OpcUaNode, found: NodeValue) -> float | Fault:
        raw = found.value
        if node.form is not None:
            number = _number_in(found, node, node.form)
            invalid = None if isinstance(number, Fault) else node.raw.fault(node.invalid, number)
            return number if isinstance(number, Fault) else invalid or node.value(number)
        if isinstance(raw, list) and len(raw) == 1 and node.element is None:
            (raw,) = raw
        if node.element is not None and not (node.element == 0 and isinstance(raw, int | float)):
            if not isinstance(raw, Sequence) or isinstance(raw, str | bytes) or len(raw) <= node.element:
                return Fault(Quality.SENSOR_FAULT, Text("opcua_no_element", element=node.element, raw=shown(raw)))
            raw = raw[node.element]
        if isinstance(raw, str) and WRITTEN_NUMBER.fullmatch(raw.strip()):
            raw = float(raw)
        if not isinstance(raw, int | float):
            return Fault(Quality.SENSOR_FAULT, Text("opcua_no_number", raw=shown(raw)))
        if isinstance(raw, bool) and (node.unit or self._profile.unit) != "1":
            return Fault(Quality.SENSOR_FAULT, Text("opcua_truth", raw=raw))
        return node.value(raw)

    def _too_old(self, found: NodeValue, age_s: float) -> Fault | None:
        limit_s = self._profile.max_age_s
        if limit_s is None:
            return None
        if found.age_s is None:
            return Fault(Quality.STALE, Text("opcua_no_time"))
        if age_s > limit_s:
            return Fault(Quality.STALE, Text("opcua_old", age_s=age_s))
        if found.age_s < -limit_s:
            return Fault(Quality.STALE, Text("opcua_ahead", ahead_s=-found.age_s))
        return None


def _number_in(found: NodeValue, node: OpcUaNode, form: struct.Struct) -> float | Fault:
    """The number that the node's bytes hold, without the bits that it leaves out."""
    data = found.data
    if data is None:
        return Fault(Quality.SENSOR_FAULT, Text("opcua_no_bytes", raw=shown(found.value)))
    first = node.element or 0
    if len(data) < (needed := first + form.size):
        return Fault(Quality.SENSOR_FAULT, Text("opcua_few_bytes", count=len(data), needed=needed))
    number: int | float = form.unpack_from(data, first)[0]
    return int(number) >> node.shift if node.shift else number
