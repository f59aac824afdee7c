"""A CANopen measuring device (CiA 404)."""

from collections.abc import Mapping, Sequence

from drivers.base import BadAnswer, Clock, Quality, Reading
from drivers.canopen.bus import CanOpenBus
from drivers.canopen.node import NO_HEARTBEAT, NodeReader
from drivers.canopen.place import CanObject
from drivers.canopen.profile import STATUS_BITS, Cia404Profile, Scaling
from drivers.canopen.settings import Cia404Options
from drivers.faults import Fault, first_fault
from drivers.readings import ReadingMaker

DEVICE_TYPE = 0x1000
SENSOR_TYPE = 0x6110
PHYSICAL_UNIT = 0x6131
DECIMAL_DIGITS = 0x6132
STATUS = 0x6150

_CIA_404 = 404


class Cia404Device:
    """One node; `channels` maps names to inputs, counted from 0 (input 0 is sub-index 1)."""

    def __init__(
        self,
        device: str,
        bus: CanOpenBus,
        profile: Cia404Profile,
        node: int,
        channels: Mapping[str, int],
        options: Cia404Options,
        clock: Clock,
    ) -> None:
        self._device, self._bus, self._profile, self._node = device, bus, profile, node
        self._channels = dict(channels)
        self._rules = profile.vendors[options.vendor].status
        self._maker = ReadingMaker(dict.fromkeys(channels, profile.unit), clock)
        self._scales: dict[int, Scaling] = {}
        # With SDO, the status is read before and after its value, in case the sensor breaks or recovers in between.
        asked = (
            CanObject(index, number + 1)
            for number in channels.values()
            for index in (STATUS, profile.value_object, STATUS)
        )
        self._reader = NodeReader(bus, device, node, options, tuple(asked), self._check)

    @property
    def device(self) -> str:
        return self._device

    @property
    def channels(self) -> tuple[str, ...]:
        return tuple(self._channels)

    async def connect(self) -> None:
        """Check device profile, sensor types, units and heartbeat, and read the number of decimal digits.

        Raises WrongDevice, or the bus's errors.
        """
        await self._reader.connect()

    async def read(self, *, again: bool = False) -> Sequence[Reading]:  # noqa: ARG002
        """One reading per channel. The node's sensors are checked again after a silence or a restart; the values of a
        node whose heartbeat has stopped are stale."""
        objects = await self._reader.read()
        values: dict[str, float | Fault] = {}
        lost = self._reader.heartbeat_lost
        for channel, number in self._channels.items():
            (value,) = objects[CanObject(self._profile.value_object, number + 1)]
            status = next((code for code in map(_code, objects[CanObject(STATUS, number + 1)]) if code), 0)
            found = self._value(channel, number, value, status)
            values[channel] = NO_HEARTBEAT if lost and not isinstance(found, Fault) else found
        return self._maker.make(values)

    async def close(self) -> None:
        """Forget what is known about the node."""
        self._reader.forget()

    async def _check(self) -> None:
        """Device profile, sensor types and units. Raises WrongDevice."""
        reader = self._reader
        (device_type,) = await reader.upload(CanObject(DEVICE_TYPE, 0))
        if (number := int.from_bytes(device_type, "little") & 0xFFFF) != _CIA_404:
            raise reader.wrong(f"node {self._node} follows device profile {number}, not 404", hint="check the node id")
        scales: dict[int, Scaling] = {}
        for channel, number in self._channels.items():
            (sensor,) = await reader.upload(CanObject(SENSOR_TYPE, number + 1))
            if (kind := int.from_bytes(sensor, "little")) not in self._profile.sensor_types:
                right = ", ".join(map(str, sorted(self._profile.sensor_types)))
                raise reader.wrong(
                    f"sensor type {kind} at input {number}",
                    channel,
                    f"set object 6110:{number + 1:02X} to one of {right}",
                )
            scales[number] = self._profile.field_scaling or await self._process_scaling(channel, number)
        self._scales = scales

    async def _process_scaling(self, channel: str, number: int) -> Scaling:
        """The decimal digits of the node's process value. Raises WrongDevice when it has another unit."""
        unit, digits = await self._reader.upload(
            *(CanObject(index, number + 1) for index in (PHYSICAL_UNIT, DECIMAL_DIGITS))
        )
        if (code := int.from_bytes(unit, "little")) != self._profile.unit_code:
            raise self._reader.wrong(
                f"unit 0x{code:08X} at input {number} is not {self._profile.unit}",
                channel,
                f"set object 6131:{number + 1:02X} to 0x{self._profile.unit_code:08X}",
            )
        return Scaling(scale=10.0 ** -int.from_bytes(digits[:1], "little", signed=True))

    def _value(self, channel: str, number: int, value: bytes, status: int) -> float | Fault:
        if status:
            unknown = Fault(Quality.SENSOR_FAULT, f"status 0x{status:02X}, which the profile does not define")
            fault = first_fault(self._rules, status & STATUS_BITS) or unknown
            emergency = self._bus.events(self._node).emergency
            return fault if emergency is None else Fault(fault.quality, f"{fault.detail}; the node reports {emergency}")
        if len(value) < (size := self._profile.value_bytes):
            raise BadAnswer(
                f"object {self._profile.value_object:04X} holds {len(value)} bytes, not {size}",
                bus=self._bus.name,
                device=self._device,
                channel=channel,
            )
        scaling = self._scales[number]
        return int.from_bytes(value[:size], "little", signed=True) * scaling.scale + scaling.offset


def _code(status: bytes) -> int:
    return int.from_bytes(status, "little")
