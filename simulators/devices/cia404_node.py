"""An emulated CANopen measuring device (CiA 404) with RTD inputs. Written from CiA 301 and CiA 404."""

import asyncio
from collections.abc import Callable, Sequence
from enum import IntEnum

from simulators.devices.slcan_adapter import CanFrame
from simulators.devices.source import Faults, SensorFault, ValueSource

PT100 = 30
DEGREE_CELSIUS = 0x002D0000

_UPLOAD = 0x40
_SEGMENT = 0x60
_ABORT = 0x80
_NO_OBJECT = 0x06020000
_NO_SUBINDEX = 0x06090011
_BAD_COMMAND = 0x05040001
_READ_ONLY = 0x06010002
_LOW, _HIGH = -200.0, 850.0
_BY_INPUT = (0x6110, 0x6131, 0x6132, 0x6150, 0x7100, 0x7130, 0x9100, 0x9130)
"""Objects with one entry for each input."""
_SIZES = {0x7100: 2, 0x7130: 2, 0x9100: 4, 0x9130: 4}
"""Bytes of the objects that contain values."""

_FIELD_ZERO, _FIELD_GAIN = 4000, 20
"""The converter's raw counts: at 0 degC, and per degC."""

_VENDOR_IDS = {"axiomatic": 0x55, "esd": 0x17}
_PRODUCT, _REVISION, _SERIAL = 404, 0x0001_0002, 4711

_STATUS_BITS = {
    "jumo": {SensorFault.OPEN: 0x01, SensorFault.SHORT: 0x01, SensorFault.OVER: 0x02, SensorFault.UNDER: 0x04},
    "axiomatic": {SensorFault.OPEN: 0x03, SensorFault.SHORT: 0x10, SensorFault.OVER: 0x20, SensorFault.UNDER: 0x10},
    "esd": {SensorFault.OPEN: 0x01, SensorFault.SHORT: 0x01, SensorFault.OVER: 0x02, SensorFault.UNDER: 0x04},
}


class Nmt(IntEnum):
    """Commands of network management (CiA 301)."""

    START = 1
    STOP = 2
    PRE_OPERATIONAL = 128
    RESET_NODE = 129
    RESET_COMMUNICATION = 130


_HEARTBEAT_STATE = {Nmt.PRE_OPERATIONAL: 0x7F, Nmt.START: 0x05, Nmt.STOP: 0x04}


class Cia404Node:
    """A node for an SlcanAdapter: SDO server (expedited uploads), TPDOs after SYNC or by timer, boot-up, heartbeat.

    Between `start` and `stop` it sends its heartbeat every `heartbeat_ms` (object 1017, real time; 0: never) and, when
    operational, its TPDOs every `event_ms` (objects 18xx:05; 0: after each SYNC instead).
    """

    def __init__(
        self,
        node_id: int,
        source: ValueSource,
        *,
        inputs: int,
        vendor: str = "jumo",
        digits: int = 1,
        sensor_types: Sequence[int] | None = None,
        heartbeat_ms: int = 0,
        event_ms: int = 0,
        mapped: int = 0x9130,
        name: str = "",
    ) -> None:
        """`mapped`: the object of the values in the TPDOs. `name`: object 1008, which goes in segments; empty: none."""
        self._node_id, self._source, self._inputs, self._digits = node_id, source, inputs, digits
        self._status_bits = _STATUS_BITS[vendor]
        self._identity = [_VENDOR_IDS[vendor], _PRODUCT, _REVISION, _SERIAL] if vendor in _VENDOR_IDS else []
        self._mapped, self._name = mapped, name.encode("ascii")
        self._segments: list[bytes] = []
        self._sensor_types = list(sensor_types or [PT100] * inputs)
        self._state = Nmt.PRE_OPERATIONAL
        self._transmission_type = 255 if event_ms else 1
        self._heartbeat_ms, self._event_ms = heartbeat_ms, event_ms
        self._timers: dict[str, asyncio.TimerHandle] = {}
        self.heartbeat_stopped = False
        """The program that sends the heartbeat hangs; the SDO server keeps running."""
        self.faults = Faults()

    def start(self, send: Callable[[Sequence[CanFrame]], None]) -> None:
        """Start sending unasked."""
        self._every(self._heartbeat_ms, self._beat, send)
        self._every(self._event_ms, self._event, send)

    def stop(self) -> None:
        """Stop sending unasked."""
        for timer in self._timers.values():
            timer.cancel()
        self._timers.clear()

    def _every(
        self, interval_ms: int, frames: Callable[[], Sequence[CanFrame]], send: Callable[[Sequence[CanFrame]], None]
    ) -> None:
        def tick() -> None:
            self._every(interval_ms, frames, send)
            if not self.faults.silent:
                send(frames())

        if interval_ms:
            self._timers[frames.__name__] = asyncio.get_running_loop().call_later(interval_ms / 1000, tick)

    def _beat(self) -> Sequence[CanFrame]:
        return () if self.heartbeat_stopped else ((0x700 + self._node_id, bytes((_HEARTBEAT_STATE[self._state],))),)

    def _event(self) -> Sequence[CanFrame]:
        return self._tpdos() if self._state == Nmt.START else ()

    def set_sensor_type(self, channel: int, code: int) -> None:
        """Set an input's sensor type, as a technician does with the maker's tool."""
        self._sensor_types[channel] = code

    def set_digits(self, digits: int) -> None:
        """Set the number of decimal digits, as if another node took this one's place."""
        self._digits = digits

    def set_transmission_type(self, kind: int) -> None:
        """When all TPDOs are sent: 1 after each SYNC, 254 and 255 on events (here the timer's only)."""
        self._transmission_type = kind

    def reboot(self) -> Sequence[CanFrame]:
        """Come back after a loss of power: send the boot-up, and wait to be started."""
        self.faults.silent = False
        return self._network_management(Nmt.RESET_NODE)

    def emergency(self, code: int) -> Sequence[CanFrame]:
        """Send an emergency when an error begins; codes 00xx clear it (CiA 301)."""
        register = 1 if code & 0xFF00 else 0
        return ((0x80 + self._node_id, code.to_bytes(2, "little") + bytes((register, 0, 0, 0, 0, 0))),)

    def on_frame(self, identifier: int, data: bytes) -> Sequence[CanFrame]:
        if self.faults.silent:
            return ()
        if identifier == 0x600 + self._node_id and len(data) == 8 and self._state != Nmt.STOP:
            reply = self._sdo(data)
            return () if reply is None else ((0x580 + self._node_id, reply),)
        if identifier == 0 and len(data) == 2 and data[1] in (0, self._node_id):
            return self._network_management(data[0])
        if identifier == 0x080 and self._state == Nmt.START and self._transmission_type == 1:
            return self._tpdos()
        return ()

    def _network_management(self, command: int) -> Sequence[CanFrame]:
        if command in (Nmt.START, Nmt.STOP, Nmt.PRE_OPERATIONAL):
            self._state = Nmt(command)
        if command in (Nmt.RESET_NODE, Nmt.RESET_COMMUNICATION):
            self._state = Nmt.PRE_OPERATIONAL
            return ((0x700 + self._node_id, b"\0"),)
        return ()

    def _sdo(self, request: bytes) -> bytes | None:
        command, place = request[0], request[1:4]
        if command == _ABORT:
            return None
        index, subindex = int.from_bytes(request[1:3], "little"), request[3]
        if command & 0xE0 == 0x20:
            return _abort(place, _READ_ONLY)
        if command & 0xE0 == _SEGMENT and self._segments:
            return self._segment(command & 0x10)
        if command != _UPLOAD:
            return _abort(place, _BAD_COMMAND)
        if (index, subindex) == (0x1008, 0) and self._name:
            self._segments = [self._name[start : start + 7] for start in range(0, len(self._name), 7)]
            return bytes((0x41,)) + place + len(self._name).to_bytes(4, "little")
        found = self._object(index, subindex)
        if isinstance(found, int):
            return _abort(place, found)
        unused = 4 - len(found)
        return bytes((0x43 | unused << 2,)) + place + found + bytes(unused)

    def _segment(self, toggle: int) -> bytes:
        data = self._segments.pop(0)
        unused, last = 7 - len(data), not self._segments
        return bytes((toggle | unused << 1 | last,)) + data + bytes(unused)

    def _object(self, index: int, subindex: int) -> bytes | int:
        """Value of an object in little-endian bytes, or an abort code."""
        if 0x1800 <= index <= 0x1803 or 0x1A00 <= index <= 0x1A03:
            return self._pdo_object(index, subindex)
        if index in _BY_INPUT:
            if subindex > self._inputs:
                return _NO_SUBINDEX
            return bytes((self._inputs,)) if subindex == 0 else self._of_input(index, subindex - 1)
        entries = self._of_node(index)
        if not entries:
            return _NO_OBJECT
        return entries[subindex] if subindex < len(entries) else _NO_SUBINDEX

    def _of_node(self, index: int) -> list[bytes]:
        """All entries of an object that describes the node; empty if it has none."""
        match index:
            case 0x1000:
                return [(0x0002_0000 + 404).to_bytes(4, "little")]
            case 0x1017:
                return [self._heartbeat_ms.to_bytes(2, "little")]
            case 0x1018 if self._identity:
                return [bytes((len(self._identity),)), *(entry.to_bytes(4, "little") for entry in self._identity)]
            case _:
                return []

    def _of_input(self, index: int, channel: int) -> bytes:
        """An object of _BY_INPUT."""
        match index:
            case 0x6110:
                return self._sensor_types[channel].to_bytes(2, "little")
            case 0x6131:
                return DEGREE_CELSIUS.to_bytes(4, "little")
            case 0x6132:
                return bytes((self._digits,))
            case 0x6150:
                return bytes((self._status(channel),))
            case 0x7100 | 0x9100:
                counts = _FIELD_ZERO + round(_FIELD_GAIN * self._measured(channel))
                return counts.to_bytes(_SIZES[index], "little", signed=True)
            case _:
                size = _SIZES[index]
                return self._process_value(channel, 8 * size).to_bytes(size, "little", signed=True)

    def _mapping(self) -> list[list[tuple[int, int, int]]]:
        """Index, sub-index and bytes of what each TPDO holds: two values each, then the status of the first inputs."""
        subindices = range(1, min(self._inputs, 6) + 1)
        value, size = self._mapped, _SIZES[self._mapped]
        pairs = [[(value, i, size) for i in subindices[start : start + 2]] for start in range(0, len(subindices), 2)]
        return [*pairs, [(0x6150, i, 1) for i in subindices]]

    def _tpdos(self) -> Sequence[CanFrame]:
        return tuple(self._tpdo(number) for number in range(len(self._mapping())))

    def _tpdo(self, number: int) -> CanFrame:
        parts = (self._object(index, subindex) for index, subindex, _ in self._mapping()[number])
        data = b"".join(part for part in parts if isinstance(part, bytes))
        return 0x180 + 0x100 * number + self._node_id, data

    def _pdo_object(self, index: int, subindex: int) -> bytes | int:
        mapping = self._mapping()
        number = index & 0xF
        used = number < len(mapping)
        if index < 0x1A00:
            identifier = 0x180 + 0x100 * number + self._node_id | (0 if used else 1 << 31)
            values = {1: identifier.to_bytes(4, "little"), 2: bytes((self._transmission_type,))}
            if self._event_ms:
                values[5] = self._event_ms.to_bytes(2, "little")
            return ({0: bytes((max(values),))} | values).get(subindex, _NO_SUBINDEX)
        entries = mapping[number] if used else []
        if subindex == 0:
            return bytes((len(entries),))
        if subindex > len(entries):
            return _NO_SUBINDEX
        mapped, part, size = entries[subindex - 1]
        return (mapped << 16 | part << 8 | 8 * size).to_bytes(4, "little")

    def _status(self, channel: int) -> int:
        fault = self.faults.by_channel.get(channel)
        if fault is None:
            value = self._source()[channel]
            fault = SensorFault.OVER if value > _HIGH else SensorFault.UNDER if value < _LOW else None
        return 0 if fault is None else self._status_bits[fault]

    def _measured(self, channel: int) -> float:
        """The temperature; a broken input shows an end of the range."""
        match self.faults.by_channel.get(channel):
            case SensorFault.OPEN | SensorFault.OVER:
                return _HIGH
            case SensorFault.SHORT | SensorFault.UNDER:
                return _LOW
            case None:
                return min(max(self._source()[channel], _LOW), _HIGH)

    def _process_value(self, channel: int, bits: int) -> int:
        """In steps of 10^-digits."""
        most = (1 << bits - 1) - 1
        counts = round(self._measured(channel) * float(10**self._digits))
        return min(max(counts, -most - 1), most)


def _abort(place: bytes, code: int) -> bytes:
    return bytes((_ABORT,)) + place + code.to_bytes(4, "little")
