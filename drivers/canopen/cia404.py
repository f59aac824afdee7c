"""A CANopen measuring device (CiA 404), read by SDO, by TPDOs after SYNC, or by TPDOs that it sends on its timer."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from time import monotonic

from drivers.base import BadAnswer, Clock, DriverError, Quality, Reading, Refused, WrongDevice
from drivers.canopen.bus import CanObject, CanOpenBus
from drivers.canopen.events import HeartbeatWatch
from drivers.canopen.pdo import COMMUNICATION, EVERY_SYNC, MAPPING, ON_EVENTS, TPDOS, PdoMap, pdo_map
from drivers.canopen.profile import STATUS_BITS, Cia404Profile, Scaling
from drivers.canopen.settings import Cia404Options
from drivers.faults import Fault, first_fault
from drivers.readings import ReadingMaker

DEVICE_TYPE = 0x1000
PRODUCER_TIME = 0x1017
SENSOR_TYPE = 0x6110
PHYSICAL_UNIT = 0x6131
DECIMAL_DIGITS = 0x6132
STATUS = 0x6150

_CIA_404 = 404
_PRODUCER_TIMES = 3
"""Heartbeats or timed TPDOs in a row until a node counts as lost: a busy bus may drop one, but not three."""

_NO_HEARTBEAT = Fault(
    Quality.STALE, "the node answers, but its heartbeat stopped: its firmware may hang; switch it off and on"
)


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
        self._boots = 0
        self._heartbeat_s = options.heartbeat_s
        self._heartbeat = HeartbeatWatch(bus.events(node))
        self._transfer = options.transfer
        self._maps: tuple[PdoMap, ...] = ()
        self._started_s = 0.0
        self._wanted = tuple(
            CanObject(index, number + 1) for number in channels.values() for index in (profile.value_object, STATUS)
        )
        # With SDO, the status is read before and after its value, in case the sensor breaks or recovers in between.
        self._asked = tuple(
            CanObject(index, number + 1)
            for number in channels.values()
            for index in (STATUS, profile.value_object, STATUS)
        )

    @property
    def device(self) -> str:
        return self._device

    @property
    def channels(self) -> tuple[str, ...]:
        return tuple(self._channels)

    async def connect(self) -> None:
        """Check device profile, heartbeat, sensor types and units, and read the number of decimal digits.

        Raises WrongDevice, or the bus's errors.
        """
        self._scales = {}
        boots = self._bus.events(self._node).boots
        (device_type,) = await self._upload([CanObject(DEVICE_TYPE, 0)])
        if (number := int.from_bytes(device_type, "little") & 0xFFFF) != _CIA_404:
            raise self._wrong(f"node {self._node} follows device profile {number}, not 404", hint="check the node id")
        limit_s = await self._heartbeat_limit_s()
        scales: dict[int, Scaling] = {}
        for channel, number in self._channels.items():
            (sensor,) = await self._upload([CanObject(SENSOR_TYPE, number + 1)])
            if (kind := int.from_bytes(sensor, "little")) not in self._profile.sensor_types:
                right = ", ".join(map(str, sorted(self._profile.sensor_types)))
                raise self._wrong(
                    f"sensor type {kind} at input {number}",
                    channel,
                    f"set object 6110:{number + 1:02X} to one of {right}",
                )
            scales[number] = self._profile.field_scaling or await self._process_scaling(channel, number)
        if self._transfer != "sdo":
            self._maps = await self._pdo_maps()
            self._started_s = monotonic()
            await self._bus.start_node(self._device, self._node, [pdo.identifier for pdo in self._maps])
        self._scales, self._boots = scales, boots
        self._heartbeat.begin(limit_s, monotonic())

    async def read(self, *, again: bool = False) -> Sequence[Reading]:  # noqa: ARG002
        """One reading per channel. The node's sensors are checked again after a silence or a restart.

        A node that restarts between two of our requests may be a different one or have a different set-up: what it sent
        in this read is discarded, and read again after the checks. A node that answers although its heartbeat has
        stopped may repeat its last measurement: its values are stale.
        """
        objects = await self._objects_of_one_start() or await self._objects_of_one_start()
        if objects is None:
            self._scales = {}
            raise BadAnswer(
                f"node {self._node} restarted twice while it was read",
                bus=self._bus.name,
                device=self._device,
                hint="check its power supply",
            )
        values: dict[str, float | Fault] = {}
        lost = self._heartbeat.silent_s(monotonic()) is not None
        for channel, number in self._channels.items():
            (value,) = objects[CanObject(self._profile.value_object, number + 1)]
            status = next((code for code in map(_code, objects[CanObject(STATUS, number + 1)]) if code), 0)
            found = self._value(channel, number, value, status)
            values[channel] = _NO_HEARTBEAT if lost and not isinstance(found, Fault) else found
        return self._maker.make(values)

    async def close(self) -> None:
        """Forget what is known about the node."""
        self._scales = {}

    async def _objects_of_one_start(self) -> dict[CanObject, list[bytes]] | None:
        """The node's answers after it was checked; None if it has restarted meanwhile."""
        events = self._bus.events(self._node)
        if not self._scales or self._boots != events.boots:
            await self.connect()
        try:
            objects = await self._objects()
        except DriverError as error:
            if not error.hurried:
                self._scales = {}
            raise
        # The boot-up message precedes everything else from the node, and the receiving thread keeps the order.
        return objects if self._boots == events.boots else None

    async def _process_scaling(self, channel: str, number: int) -> Scaling:
        """The decimal digits of the node's process value. Raises WrongDevice when it has another unit."""
        unit, digits = await self._upload([CanObject(index, number + 1) for index in (PHYSICAL_UNIT, DECIMAL_DIGITS)])
        if (code := int.from_bytes(unit, "little")) != self._profile.unit_code:
            raise self._wrong(
                f"unit 0x{code:08X} at input {number} is not {self._profile.unit}",
                channel,
                f"set object 6131:{number + 1:02X} to 0x{self._profile.unit_code:08X}",
            )
        return Scaling(scale=10.0 ** -int.from_bytes(digits[:1], "little", signed=True))

    async def _heartbeat_limit_s(self) -> float:
        """Consumer time, s; 0 if no heartbeat is expected. Raises WrongDevice when the node's heartbeat is too slow."""
        try:
            (producer,) = await self._upload([CanObject(PRODUCER_TIME, 0)])
        except Refused:  # the object is optional when the node uses node guarding
            producer = b""
        producer_s = int.from_bytes(producer[:2], "little") / 1000
        if self._heartbeat_s and not 0 < producer_s < self._heartbeat_s:
            sends = f"every {producer_s:g} s" if producer_s else "never"
            raise self._wrong(
                f"node {self._node} sends its heartbeat {sends}, but heartbeat_s = {self._heartbeat_s:g}",
                hint="set object 1017:00 to a third of that, in ms, or leave heartbeat_s out",
            )
        return self._heartbeat_s or _PRODUCER_TIMES * producer_s

    async def _objects(self) -> dict[CanObject, list[bytes]]:
        """Values and status of all channels, as many times as each was read."""
        if self._transfer == "sdo":
            read: dict[CanObject, list[bytes]] = {}
            for asked, data in zip(self._asked, await self._upload(self._asked), strict=True):
                read.setdefault(asked, []).append(data)
            return read
        identifiers = [pdo.identifier for pdo in self._maps]
        if self._transfer == "sync":
            frames = await self._bus.synchronise(self._device, self._node, identifiers)
        else:
            # Frames from before the check may be those of another node, or have another mapping.
            interval_s, now_s = max(pdo.event_s for pdo in self._maps), monotonic()
            oldest_s = max(self._started_s, now_s - _PRODUCER_TIMES * interval_s)
            # One more interval, so that no node counts as lost on a computer that was briefly busy.
            until_s = max(self._started_s + self._bus.timeout_s, now_s + interval_s)
            frames = await self._bus.latest(self._device, self._node, identifiers, oldest_s, until_s)
        objects = {place: [data] for pdo in self._maps for place, data in pdo.decode(frames[pdo.identifier]).items()}
        for wanted in self._wanted:
            if wanted not in objects:
                raise BadAnswer(f"object {wanted} is missing in its TPDO", bus=self._bus.name, device=self._device)
        return objects

    async def _pdo_maps(self) -> tuple[PdoMap, ...]:
        """The TPDOs that hold the wanted objects, each transmitted as the transfer requires. Raises WrongDevice."""
        found: list[PdoMap] = []
        for number in range(TPDOS):
            description = [
                CanObject(COMMUNICATION + number, 1),
                CanObject(COMMUNICATION + number, 2),
                CanObject(MAPPING + number, 0),
            ]
            try:
                cob_id, kind, count = await self._upload(description)
            except Refused:  # the node has no more TPDOs
                continue
            entries = await self._upload([CanObject(MAPPING + number, i + 1) for i in range(min(count[0], 8))])
            try:
                pdo = pdo_map(int.from_bytes(cob_id, "little"), [int.from_bytes(entry, "little") for entry in entries])
            except ValueError as error:
                raise self._wrong(f"TPDO {number + 1}: {error}", hint="use transfer = 'sdo'") from error
            if pdo is not None and any(wanted in pdo.places for wanted in self._wanted):
                found.append(await self._timed(number, kind[0], pdo))
        for wanted in self._wanted:
            if not any(wanted in pdo.places for pdo in found):
                raise self._wrong(f"object {wanted} is not mapped to any TPDO", hint="map it, or use transfer = 'sdo'")
        return tuple(found)

    async def _timed(self, number: int, kind: int, pdo: PdoMap) -> PdoMap:
        """The TPDO with its event timer. Raises WrongDevice when it is not transmitted as the transfer requires."""
        right = (EVERY_SYNC,) if self._transfer == "sync" else ON_EVENTS
        if kind not in right:
            raise self._wrong(
                f"TPDO {number + 1} has transmission type {kind}, not {right[-1]}",
                hint=f"set object {COMMUNICATION + number:04X}:02 to {right[-1]}, or use another transfer",
            )
        if self._transfer == "sync":
            return pdo
        timer = CanObject(COMMUNICATION + number, 5)
        try:
            (interval,) = await self._upload([timer])
        except Refused:  # the object is optional
            interval = b""
        event_s = int.from_bytes(interval[:2], "little") / 1000
        if not 0 < event_s < self._bus.timeout_s:
            sends = f"sent every {event_s:g} s" if event_s else "never sent on a timer"
            raise self._wrong(
                f"TPDO {number + 1} is {sends}, but timeout_s = {self._bus.timeout_s:g}",
                hint=f"set object {timer} to less than that, in ms; best to a third of the polling period",
            )
        return replace(pdo, event_s=event_s)

    async def _upload(self, objects: Sequence[CanObject]) -> list[bytes]:
        return await self._bus.upload(self._device, self._node, objects)

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

    def _wrong(self, what: str, channel: str = "", hint: str = "") -> WrongDevice:
        return WrongDevice(what, bus=self._bus.name, device=self._device, channel=channel, hint=hint)


def _code(status: bytes) -> int:
    return int.from_bytes(status, "little")
