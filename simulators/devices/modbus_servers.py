"""Servers for emulated Modbus units: on one serial line, or behind one TCP port."""

import struct
from collections.abc import Iterator, Mapping

from simulators.devices.loopback import Connection, LoopbackServer
from simulators.devices.modbus_unit import ModbusUnit, answer
from simulators.devices.pty_port import PtyPort
from simulators.devices.spoil import Spoil, send

_REQUEST_BYTES = 8
_MBAP = struct.Struct(">HHHB")


def _crc_table() -> list[int]:
    table = []
    for byte in range(256):
        crc = byte
        for _ in range(8):
            crc = crc >> 1 ^ 0xA001 if crc & 1 else crc >> 1
        table.append(crc)
    return table


_CRC_TABLE = _crc_table()


def crc16(data: bytes) -> bytes:
    """CRC-16/MODBUS, low byte first (MODBUS over serial line V1.02, appendix B)."""
    crc = 0xFFFF
    for byte in data:
        crc = crc >> 8 ^ _CRC_TABLE[(crc ^ byte) & 0xFF]
    return crc.to_bytes(2, "little")


class _RtuRequests:
    """Finds the requests in the bytes that are received, and has the units answer."""

    def __init__(self, units: Mapping[int, ModbusUnit]) -> None:
        self._units = dict(units)
        self._heard = b""

    def answered(self, data: bytes) -> Iterator[tuple[int, bytes]]:
        """Unit and answer to each request of 8 bytes; a byte that does not start a valid request is skipped."""
        self._heard += data
        while len(self._heard) >= _REQUEST_BYTES:
            frame, rest = self._heard[:_REQUEST_BYTES], self._heard[_REQUEST_BYTES:]
            if crc16(frame[:-2]) != frame[-2:]:
                self._heard = self._heard[1:]
                continue
            self._heard = rest
            unit = self._units.get(frame[0])
            if unit is not None and not unit.silent:
                reply = frame[:1] + answer(unit, frame[1:-2])
                yield frame[0], reply + crc16(reply)


class RtuLine:
    """Several units on one pseudo-terminal. `await start()` gives its path.

    baud: the units' speed; at any other speed they receive garbage and stay silent. 0: they understand any
    """

    def __init__(self, units: Mapping[int, ModbusUnit], *, baud: int = 0) -> None:
        self._requests, self._baud = _RtuRequests(units), baud
        self._port = PtyPort(self._on_bytes)
        self.spoil: Spoil | None = None
        """What happens to answers on the wire."""
        self.garbage = 0
        """Bytes that came at another speed than the units'."""

    async def start(self) -> str:
        return await self._port.start()

    async def stop(self) -> None:
        await self._port.stop()

    def _on_bytes(self, data: bytes) -> None:
        if self._baud and self._port.baud != self._baud:
            self.garbage += len(data)
            return
        for unit, reply in self._requests.answered(data):
            send(self._port.write, self.spoil, unit, reply)


class TcpHost:
    """Units behind one loopback port. `await start()` gives the port number."""

    def __init__(self, units: Mapping[int, ModbusUnit]) -> None:
        self.units = dict(units)
        self.server = LoopbackServer(lambda: _TcpConnection(self))
        self.spoil: Spoil | None = None
        """What happens to answers on the wire."""

    async def start(self, port: int = 0) -> int:
        return await self.server.start(port)

    async def stop(self) -> None:
        await self.server.stop()


class _TcpConnection(Connection):
    def __init__(self, host: TcpHost) -> None:
        super().__init__()
        self._host = host
        self._heard = b""

    def data_received(self, data: bytes) -> None:
        if self.forgotten:
            return
        self._heard += data
        while len(self._heard) >= _MBAP.size:
            number, protocol, length, unit_id = _MBAP.unpack_from(self._heard)
            if protocol != 0 or not 2 <= length <= 254:
                self.abort()
                return
            if len(self._heard) < 6 + length:
                return
            pdu, self._heard = self._heard[_MBAP.size : 6 + length], self._heard[6 + length :]
            unit = self._host.units.get(unit_id)
            if unit is not None and not unit.silent and self.transport is not None:
                reply = answer(unit, pdu)
                frame = _MBAP.pack(number, 0, len(reply) + 1, unit_id) + reply
                send(self.transport.write, self._host.spoil, unit_id, frame)


class DeviceServer:
    """Units on a serial line behind a device server's loopback port, which passes on the bytes of every connection.
    `await start()` gives the port number."""

    def __init__(self, units: Mapping[int, ModbusUnit]) -> None:
        self._requests = _RtuRequests(units)
        self.server = LoopbackServer(lambda: _ServedLine(self))
        self.spoil: Spoil | None = None
        """What happens to answers on the wire."""

    async def start(self, port: int = 0) -> int:
        return await self.server.start(port)

    async def stop(self) -> None:
        await self.server.stop()

    def hear(self, data: bytes) -> None:
        """Bytes for the serial line."""
        for unit, reply in self._requests.answered(data):
            send(self._tell, self.spoil, unit, reply)

    def _tell(self, data: bytes) -> None:
        """Send bytes from the line to every client that is connected by then."""
        for connection in self.server.connections:
            if connection.transport is not None and not connection.forgotten:
                connection.transport.write(data)


class _ServedLine(Connection):
    def __init__(self, server: DeviceServer) -> None:
        super().__init__()
        self._server = server

    def data_received(self, data: bytes) -> None:
        if not self.forgotten:
            self._server.hear(data)
