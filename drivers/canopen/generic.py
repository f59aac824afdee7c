"""A CANopen node of any kind, whose profile lists the objects that are channels."""

import struct
from collections.abc import Mapping, Sequence

from drivers.base import Clock, DriverError, Quality, Reading
from drivers.canopen.bus import CanOpenBus, Uncounted
from drivers.canopen.node import NodeReader
from drivers.canopen.objects import CanOpenProfile
from drivers.canopen.place import CanObject
from drivers.canopen.settings import NodeOptions
from drivers.faults import Fault
from drivers.number_types import BYTE_FORMATS, raw_number
from drivers.readings import ReadingMaker
from drivers.text import Text

_IDENTITY = 0x1018


class CanOpenDevice:
    """One node; `channels` maps names to the profile's objects, counted from 0."""

    def __init__(
        self,
        device: str,
        bus: CanOpenBus,
        profile: CanOpenProfile,
        node: int,
        channels: Mapping[str, int],
        options: NodeOptions,
        clock: Clock,
    ) -> None:
        self.device, self.channels = device, tuple(channels)
        self._bus, self._profile, self._node = bus, profile, node
        self._channels = dict(channels)
        units = {name: profile.objects[number].unit or profile.unit for name, number in channels.items()}
        self._maker = ReadingMaker(units, clock)
        self._by_sdo = options.transfer == "sdo"
        self._unmapped: Mapping[CanObject, DriverError] = {}
        """Why objects are not expected in TPDOs."""
        places = tuple(profile.objects[number].place for number in channels.values())
        self._reader = NodeReader(bus, device, node, options, places, self._check, each=True, identify=self._identify)

    async def connect(self) -> None:
        """Check the node's identity, objects, heartbeat and TPDOs. Raises WrongDevice, or the bus's errors."""
        await self._reader.connect()

    async def read(self, *, again: bool = False) -> Sequence[Reading]:  # noqa: ARG002
        """One reading per channel. An object that the node refuses or answers badly affects its own channel only."""
        objects = await self._reader.read()
        doubt = self._reader.doubt
        lost = {**self._unmapped, **self._reader.lost}
        values: dict[str, float | Fault] = {}
        for channel, number in self._channels.items():
            place = self._profile.objects[number].place
            if place in lost:
                values[channel] = Fault(Quality.COMM_FAULT, lost[place].what)
                continue
            found = self._value(number, objects[place][0])
            values[channel] = found if doubt is None or isinstance(found, Fault) else doubt
        places = {name: (self._profile.objects[number].place,) for name, number in self._channels.items()}
        return self._maker.make(values, self._reader.ages_s(places))

    async def close(self) -> None:
        """Forget what is known about the node."""
        self._reader.forget()

    async def _check(self) -> None:
        """Identity, and which objects the node has. Raises WrongDevice, or why none of them can be read."""
        await self._identify()
        reader, profile = self._reader, self._profile
        places = tuple(dict.fromkeys(profile.objects[number].place for number in self._channels.values()))
        readable = await reader.upload_each(places)
        self._unmapped = {} if self._by_sdo else dict(reader.lost)
        reader.ask(places if self._by_sdo else list(readable))

    async def _identify(self) -> None:
        """Raises WrongDevice."""
        reader, profile = self._reader, self._profile
        for subindex, name, wanted in ((1, "vendor_id", profile.vendor_id), (2, "product_code", profile.product_code)):
            if wanted is None:
                continue
            (data,) = await reader.upload(CanObject(_IDENTITY, subindex))
            if (found := int.from_bytes(data, "little")) != wanted:
                raise reader.wrong(
                    Text("canopen_identity", node=self._node, name=name, found=found, wanted=wanted),
                    hint=Text("canopen_check_profile"),
                )

    def _value(self, number: int, data: bytes) -> float | Fault:
        entry, kind = self._profile.objects[number], self._profile.types[number]
        form = struct.Struct("<" + BYTE_FORMATS[kind])
        if isinstance(data, Uncounted):
            data = data[: form.size]
        if len(data) != form.size:
            text = Text("canopen_bytes", place=str(entry.place), count=len(data), kind=kind, size=form.size)
            return Fault(Quality.COMM_FAULT, text)
        (raw,) = form.unpack(data)
        fault = raw_number(kind, str(entry.place)).fault(entry.invalid, raw)
        if fault is not None:
            return self._bus.events(self._node).with_emergency(fault)
        return entry.value(raw)
