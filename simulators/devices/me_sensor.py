"""An emulated displacement sensor with Micro-Epsilon's RS-485 framing."""

import struct
from collections.abc import Sequence
from math import isnan, nan
from typing import Literal

from simulators.devices.pty_port import PtyPort
from simulators.devices.source import Faults, SensorFault, ValueSource
from simulators.devices.spoil import Spoil, send

ADDRESS = 0x7E
_MASTER = 0x01
_MEASURE = 0x4C
_RESPONSE = 0x08
_REQUEST_BYTES = 6
_FULL_SCALE = 0xF00000
_COUNTS = 0xFFFFFF

Payload = Literal["float", "counted"]


class MeSensor:
    """One sensor; its source gives one distance in µm, 0 to `range_um`. From start to stop it is alone on a line."""

    def __init__(
        self, source: ValueSource, *, range_um: float, address: int = ADDRESS, payload: Payload = "float"
    ) -> None:
        self._source, self._range_um, self.address = source, range_um, address
        self._payload, self._counter = payload, 0
        self._line: MeLine | None = None
        self.frozen = False
        """Whether it answers with its last values again and again; payload `counted` only."""
        self._last: list[int] = []
        self.faults = Faults()

    async def start(self) -> str:
        self._line = MeLine([self])
        return await self._line.start()

    async def stop(self) -> None:
        if self._line is not None:
            await self._line.stop()

    def answer(self) -> bytes:
        """The answer to a request, at this moment."""
        if self._payload == "float":
            return answer_frame(self.address, self._unscaled(), 0.0)
        if not (self.frozen and self._last):
            self._counter = (self._counter + 1) & 0xFFFF
            self._last = [self._counts()]
        return counted_frame(self.address, self._counter, self._last)

    def _counts(self) -> int:
        """0 to F00000 hex over the measuring range; a missing probe has no code: it reads beyond the end."""
        unscaled = self._unscaled()
        return _COUNTS if isnan(unscaled) else round(unscaled * _FULL_SCALE)

    def _unscaled(self) -> float:
        match self.faults.by_channel.get(0):
            case SensorFault.OPEN | SensorFault.SHORT:
                return nan
            case SensorFault.OVER:
                return 1.1
            case SensorFault.UNDER:
                return -0.1
            case None:
                return self._source()[0] / self._range_um


class MeLine:
    """Sensors with different addresses on one pseudo-terminal."""

    def __init__(self, sensors: Sequence[MeSensor]) -> None:
        self._sensors = {sensor.address: sensor for sensor in sensors}
        self._port = PtyPort(self._on_bytes)
        self._heard = b""
        self.spoil: Spoil | None = None
        """What happens to answers on the wire; the sender is the sensor's address."""

    async def start(self) -> str:
        return await self._port.start()

    async def stop(self) -> None:
        await self._port.stop()

    def _on_bytes(self, data: bytes) -> None:
        self._heard += data
        while len(self._heard) >= _REQUEST_BYTES:
            frame = self._heard[:_REQUEST_BYTES]
            if frame[0] != 0x10 or frame[5] != 0x16 or sum(frame[1:4]) & 0xFF != frame[4]:
                self._heard = self._heard[1:]
                continue
            self._heard = self._heard[_REQUEST_BYTES:]
            sensor = self._sensors.get(frame[1])
            if sensor is not None and frame[3] == _MEASURE and not sensor.faults.silent:
                send(self._port.write, self.spoil, sensor.address, sensor.answer())


def answer_frame(address: int, unscaled: float, scaled: float) -> bytes:
    """The answer that carries these two values."""
    return _frame(address, struct.pack("<ff", unscaled, scaled))


def counted_frame(address: int, counter: int, values: Sequence[int]) -> bytes:
    """The answer of a DT6120: counter, number of values, filler, values."""
    return _frame(address, struct.pack(f"<HBx{len(values)}i", counter, len(values), *values))


def _frame(address: int, data: bytes) -> bytes:
    body = bytes((_MASTER, address, _RESPONSE)) + data
    return bytes((0x68, len(body), len(body), 0x68)) + body + bytes((sum(body) & 0xFF, 0x16))
