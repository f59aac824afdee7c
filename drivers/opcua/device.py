"""Nodes of an OPC UA server as the channels of a device."""

import struct
from collections.abc import Mapping, Sequence

from drivers.base import Clock, Quality, Reading, WrongDevice
from drivers.faults import Fault
from drivers.opcua.bus import OpcUaBus
from drivers.opcua.nodes import NodeValue
from drivers.opcua.profile import OpcUaNode, OpcUaProfile
from drivers.readings import ReadingMaker


class OpcUaDevice:
    """Some nodes of a server; `channels` maps names to the profile's nodes, counted from 0."""

    def __init__(
        self, device: str, bus: OpcUaBus, profile: OpcUaProfile, channels: Mapping[str, int], clock: Clock
    ) -> None:
        self._device, self._bus, self._profile = device, bus, profile
        self._nodes = {name: profile.nodes[number] for name, number in channels.items()}
        self._names = tuple(profile.names[number] for number in channels.values())
        self._maker = ReadingMaker({name: node.unit or profile.unit for name, node in self._nodes.items()}, clock)

    @property
    def device(self) -> str:
        return self._device

    @property
    def channels(self) -> tuple[str, ...]:
        return tuple(self._nodes)

    async def connect(self) -> None:
        """Check that the server has at least one of the nodes. Raises WrongDevice, or the bus's errors."""
        values = await self._ask()
        if all(value.is_unknown for value in values):
            raise WrongDevice(
                f"the server has none of the nodes {', '.join(map(str, self._names[:3]))}",
                bus=self._bus.name,
                device=self._device,
                hint="compare ids and namespace with the server's own, case included",
            )

    async def read(self, *, again: bool = False) -> Sequence[Reading]:  # noqa: ARG002
        """One reading per channel. A node that cannot be read affects its own channel only."""
        values = await self._ask()
        pairs = zip(self._nodes.items(), values, strict=True)
        return self._maker.make({name: self._judged(node, value) for (name, node), value in pairs})

    async def close(self) -> None:
        """Nothing to close: the session is the bus's."""

    async def _ask(self) -> list[NodeValue]:
        return await self._bus.read(self._device, self._names, aged=self._profile.max_age_s is not None)

    def _judged(self, node: OpcUaNode, found: NodeValue) -> float | Fault:
        fault = found.fault() or self._too_old(found)
        if fault is not None:
            return fault
        raw = found.value
        if node.form is not None:
            number = _number_in(found, node, node.form)
            invalid = None if isinstance(number, Fault) else node.raw.fault(node.invalid, number)
            return number if isinstance(number, Fault) else invalid or node.value(number)
        if node.element is not None:
            if not isinstance(raw, Sequence) or isinstance(raw, str | bytes) or len(raw) <= node.element:
                return Fault(Quality.SENSOR_FAULT, f"the node holds no element {node.element}: {_shown(raw)}")
            raw = raw[node.element]
        if not isinstance(raw, int | float):
            return Fault(Quality.SENSOR_FAULT, f"the node holds no number: {_shown(raw)}")
        if isinstance(raw, bool) and (node.unit or self._profile.unit) != "1":
            return Fault(Quality.SENSOR_FAULT, f'the node holds {raw}; that is a number only with unit = "1"')
        return node.value(raw)

    def _too_old(self, found: NodeValue) -> Fault | None:
        limit_s = self._profile.max_age_s
        if limit_s is None:
            return None
        if found.age_s is None:
            return Fault(Quality.STALE, "the server does not say when the value was measured; omit max_age_s")
        if found.age_s > limit_s:
            return Fault(Quality.STALE, f"the server's source measured it {found.age_s:.0f} s ago")
        if found.age_s < -limit_s:  # whatever stands still looks new until then
            text = f"its source timestamp is {-found.age_s:.0f} s ahead of the server's clock"
            return Fault(Quality.STALE, text + "; set the source's clock, or omit max_age_s")
        return None


def _number_in(found: NodeValue, node: OpcUaNode, form: struct.Struct) -> float | Fault:
    """The number that the node's bytes hold, without the bits that it leaves out."""
    data = found.data
    if data is None:
        return Fault(Quality.SENSOR_FAULT, f"the node holds no bytes: {_shown(found.value)}")
    first = node.element or 0
    if len(data) < (needed := first + form.size):
        return Fault(Quality.SENSOR_FAULT, f"the node holds {len(data)} of the {needed} bytes that the channel needs")
    number: int | float = form.unpack_from(data, first)[0]
    return int(number) >> node.shift if node.shift else number


def _shown(raw: object) -> str:
    text = repr(raw)
    return text if len(text) <= 40 else text[:37] + "..."
