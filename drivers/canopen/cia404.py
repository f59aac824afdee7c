"""A CANopen measuring device (CiA 404)."""

from collections.abc import Mapping, Sequence

from drivers.base import Clock, DriverError, Quality, Reading, Refused
from drivers.canopen.bus import CanOpenBus, Uncounted
from drivers.canopen.node import NodeReader
from drivers.canopen.place import CanObject
from drivers.canopen.profile import STATUS_BITS, Cia404Profile, Scaling
from drivers.canopen.settings import Cia404Options
from drivers.faults import Fault, first_fault
from drivers.readings import ReadingMaker, total
from drivers.text import Text

DEVICE_TYPE = 0x1000
SENSOR_TYPE = 0x6110
PHYSICAL_UNIT = 0x6131
DECIMAL_DIGITS = 0x6132
_STATUS = 0x6150

_CIA_404 = 404
_MOST_DIGITS = 9


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
        self.device, self.channels = device, tuple(channels)
        self._bus, self._profile, self._node = bus, profile, node
        self._channels = dict(channels)
        self._rules = () if options.vendor is None else profile.vendors[options.vendor].status
        self._maker = ReadingMaker(dict.fromkeys(channels, profile.unit), clock)
        self._scales: dict[int, Scaling] = {}
        self._absent: dict[int, Refused] = {}
        """Why inputs cannot be read, since the node was checked."""
        self._reader = NodeReader(bus, device, node, options, self._objects(), self._check, each=True)

    async def connect(self) -> None:
        """Check device profile, sensor types, units and heartbeat, and read the number of decimal digits.

        Raises WrongDevice, Refused when the node has none of the inputs, or the bus's errors.
        """
        await self._reader.connect()

    async def read(self, *, again: bool = False) -> Sequence[Reading]:  # noqa: ARG002
        """One reading per channel. The node's sensors are checked again after a silence or a restart; the values of a
        node whose heartbeat has stopped are stale. An input that the node does not have, or an object that it refuses
        or answers badly, affects its own channel only."""
        objects = await self._reader.read()
        values: dict[str, float | Fault] = {}
        doubt = self._reader.doubt
        lost: dict[CanObject, DriverError] = dict(self._reader.lost)
        for channel, number in self._channels.items():
            places = self._places(number)
            error = self._absent.get(number) or next((lost[place] for place in places if place in lost), None)
            if error is not None:
                values[channel] = Fault(Quality.COMM_FAULT, error.what)
                continue
            codes, (value,) = (objects[place] for place in places)
            found = self._value(number, value, next((code for code in map(_code, codes) if code), 0))
            values[channel] = found if doubt is None or isinstance(found, Fault) else doubt
        await self._look_again()
        ages_s = self._reader.ages_s({name: self._places(number) for name, number in self._channels.items()})
        return self._maker.make(values, ages_s)

    async def close(self) -> None:
        """Forget what is known about the node."""
        self._reader.forget()

    async def _check(self) -> None:
        """Device profile, sensor types and units. Raises WrongDevice, or Refused if the node has none of the inputs."""
        reader = self._reader
        (device_type,) = await reader.upload(CanObject(DEVICE_TYPE, 0))
        if (number := int.from_bytes(device_type, "little") & 0xFFFF) != _CIA_404:
            raise reader.wrong(
                Text("cia404_other_profile", node=self._node, number=number), hint=Text("canopen_check_id")
            )
        scales: dict[int, Scaling] = {}
        absent: dict[int, Refused] = {}
        for channel, number in self._channels.items():
            try:
                scales[number] = await self._checked(channel, number)
            except Refused as error:
                absent[number] = error
        if not scales:
            raise next(iter(absent.values()))
        self._scales, self._absent = scales, absent
        reader.ask(self._objects())

    async def _checked(self, channel: str, number: int) -> Scaling:
        """The scaling of an input. Raises WrongDevice when it measures something else, or Refused."""
        (sensor,) = await self._reader.upload(CanObject(SENSOR_TYPE, number + 1))
        if (kind := int.from_bytes(sensor, "little")) not in self._profile.sensor_types:
            right = ", ".join(map(str, sorted(self._profile.sensor_types)))
            raise self._reader.wrong(
                Text("cia404_sensor_type", kind=kind, number=number),
                channel,
                Text("cia404_set_type", number=number + 1, right=right),
            )
        return self._profile.field_scaling or await self._process_scaling(channel, number)

    async def _look_again(self) -> None:
        """Check the node before the next read if it now has an input that it did not have."""
        for number in self._absent:
            try:
                await self._reader.upload(CanObject(SENSOR_TYPE, number + 1))
            except DriverError:
                continue
            self._reader.forget()

    def _places(self, number: int) -> tuple[CanObject, CanObject]:
        """Status and value of an input."""
        return CanObject(_STATUS, number + 1), CanObject(self._profile.value_object, number + 1)

    def _objects(self) -> tuple[CanObject, ...]:
        """What is read. With SDO, the status before and after its value, in case the sensor breaks or recovers."""
        order = _STATUS, self._profile.value_object, _STATUS
        present = (number for number in self._channels.values() if number not in self._absent)
        return tuple(CanObject(index, number + 1) for number in present for index in order)

    async def _process_scaling(self, channel: str, number: int) -> Scaling:
        """The decimal digits of the node's process value. Raises WrongDevice when it has another unit."""
        unit, digits = await self._reader.upload(
            *(CanObject(index, number + 1) for index in (PHYSICAL_UNIT, DECIMAL_DIGITS))
        )
        if (code := int.from_bytes(unit, "little")) != self._profile.unit_code:
            raise self._reader.wrong(
                Text("cia404_unit", code=code, number=number, unit=self._profile.unit),
                channel,
                Text("cia404_set_unit", number=number + 1, unit_code=self._profile.unit_code),
            )
        if (places := int.from_bytes(digits, "little")) > _MOST_DIGITS:
            raise self._reader.wrong(
                Text("cia404_digits", places=places, number=number, most=_MOST_DIGITS),
                channel,
                Text("cia404_set_digits", number=number + 1),
            )
        return Scaling(scale=10.0**-places)

    def _value(self, number: int, value: bytes, status: int) -> float | Fault:
        if status:
            unknown = Fault(Quality.SENSOR_FAULT, Text("canopen_status_undefined", status=status))
            fault = first_fault(self._rules, status & STATUS_BITS) or unknown
            return self._bus.events(self._node).with_emergency(fault)
        size = self._profile.value_bytes
        if len(value) < size or (len(value) > size and not isinstance(value, Uncounted)):
            what = Text("cia404_holds", object=self._profile.value_object, count=len(value), size=size)
            return Fault(Quality.COMM_FAULT, what)
        raw, scaling = int.from_bytes(value[:size], "little", signed=True), self._scales[number]
        if raw in (-(1 << 8 * size - 1), (1 << 8 * size - 1) - 1):  # what converters send that have no value, or no end
            return Fault(Quality.OUT_OF_RANGE, Text("cia404_end", raw=f"{raw % (1 << 8 * size):0{2 * size}X}"))
        return total(raw * scaling.scale, scaling.offset)


def _code(status: bytes) -> int:
    return int.from_bytes(status, "little")
