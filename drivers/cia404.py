"""A CANopen measuring device (CiA 404), polled by SDO."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from drivers.base import BadAnswer, Clock, DriverError, Quality, Reading, WrongDevice
from drivers.canopen_bus import CanObject, CanOpenBus
from drivers.canopen_profile import Cia404Profile
from drivers.faults import Fault, first_fault
from drivers.readings import ReadingMaker

DEVICE_TYPE = 0x1000
SENSOR_TYPE = 0x6110
PHYSICAL_UNIT = 0x6131
DECIMAL_DIGITS = 0x6132
STATUS = 0x6150

_CIA_404 = 404


@dataclass(frozen=True, slots=True, kw_only=True)
class Cia404Options:
    """What a configuration may say about one node."""

    vendor: str
    """Whose table of status bits applies; the profile lists them."""


class Cia404Device:
    """One node; `channels` maps names to inputs counted from 0 (input 0 is sub-index 1)."""

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
        self._rules = profile.vendors[options.vendor]
        self._maker = ReadingMaker(profile.unit, clock)
        self._size = 2 if profile.process_value == 0x7130 else 4
        self._scales: dict[int, float] = {}
        self._boots = 0
        self._polled = [
            CanObject(index, number + 1) for number in channels.values() for index in (profile.process_value, STATUS)
        ]

    @property
    def device(self) -> str:
        return self._device

    @property
    def channels(self) -> tuple[str, ...]:
        return tuple(self._channels)

    async def connect(self) -> None:
        """Check device profile, sensor types and units, and read the decimal digits.

        Raises WrongDevice, or what the bus raises.
        """
        self._scales = {}
        boots = self._bus.events(self._node).boots
        (device_type,) = await self._upload([CanObject(DEVICE_TYPE, 0)])
        if (number := int.from_bytes(device_type, "little") & 0xFFFF) != _CIA_404:
            raise self._wrong(f"node {self._node} follows device profile {number}, not 404", hint="check the node id")
        scales: dict[int, float] = {}
        for channel, number in self._channels.items():
            sensor, unit, digits = await self._upload(
                [CanObject(index, number + 1) for index in (SENSOR_TYPE, PHYSICAL_UNIT, DECIMAL_DIGITS)]
            )
            if (kind := int.from_bytes(sensor, "little")) not in self._profile.sensor_types:
                right = ", ".join(map(str, sorted(self._profile.sensor_types)))
                raise self._wrong(
                    f"sensor type {kind} at input {number}",
                    channel,
                    f"set object 6110:{number + 1:02X} to one of {right}",
                )
            if (code := int.from_bytes(unit, "little")) != self._profile.unit_code:
                raise self._wrong(
                    f"unit 0x{code:08X} at input {number} is not {self._profile.unit}",
                    channel,
                    f"set object 6131:{number + 1:02X} to 0x{self._profile.unit_code:08X}",
                )
            scales[number] = 10.0 ** -int.from_bytes(digits[:1], "little", signed=True)
        self._scales, self._boots = scales, boots

    async def read(self) -> Sequence[Reading]:
        """One reading per channel. The node's sensors are checked again after it was silent or has started anew."""
        if not self._scales or self._boots != self._bus.events(self._node).boots:
            await self.connect()
        try:
            answers = await self._upload(self._polled)
        except DriverError:
            self._scales = {}
            raise
        values: dict[str, float | Fault] = {}
        pairs = zip(answers[::2], answers[1::2], strict=True)
        for (channel, number), (value, status) in zip(self._channels.items(), pairs, strict=True):
            values[channel] = self._value(channel, number, value, int.from_bytes(status, "little"))
        return self._maker.make(values)

    async def close(self) -> None:
        """Forget what was learnt about the node."""
        self._scales = {}

    async def _upload(self, objects: Sequence[CanObject]) -> list[bytes]:
        return await self._bus.upload(self._device, self._node, objects)

    def _value(self, channel: str, number: int, value: bytes, status: int) -> float | Fault:
        if status:
            unknown = Fault(Quality.SENSOR_FAULT, f"status 0x{status:02X}, which the profile does not explain")
            fault = first_fault(self._rules, status) or unknown
            emergency = self._bus.events(self._node).emergency
            return fault if emergency is None else Fault(fault.quality, f"{fault.detail}; the node reports {emergency}")
        if len(value) < self._size:
            raise BadAnswer(
                f"object {self._profile.process_value:04X} holds {len(value)} bytes, not {self._size}",
                bus=self._bus.name,
                device=self._device,
                channel=channel,
            )
        return int.from_bytes(value[: self._size], "little", signed=True) * self._scales[number]

    def _wrong(self, what: str, channel: str = "", hint: str = "") -> WrongDevice:
        return WrongDevice(what, bus=self._bus.name, device=self._device, channel=channel, hint=hint)
