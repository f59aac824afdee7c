"""Modbus TCP to a server that does not copy a request's number: answers are told apart as on a serial line."""

from drivers.byte_stream import ByteStream, TcpStream
from drivers.modbus.frames import TCP_HEADER, begins_message, rtu_frame, tcp_messages
from drivers.modbus.rtu import RtuFramedBus
from drivers.modbus.settings import ModbusTcpSettings
from drivers.tap import Tap

_PAUSE_S = 0.05
"""The parts of one message follow within this time."""
_NUMBERS = 0x10000


class UnnumberedTcpBus(RtuFramedBus):
    """Units behind one host that answers in order. Answers whose form does not say whose they are are asked for again,
    as on a serial line; a new connection has none of an earlier one."""

    kind = ModbusTcpSettings.bus_kind
    units = ModbusTcpSettings.units
    has_checksum = False
    reopens = True

    def __init__(self, name: str, settings: ModbusTcpSettings, tap: Tap | None = None) -> None:
        stream = _AsOnALine(TcpStream(name, settings.host, settings.port, tap))
        super().__init__(name, settings, stream, local_echo=False, gap_s=0.0, pause_s=_PAUSE_S)

    def other_master(self) -> str:
        """A connection has none."""
        return ""

    def _opened(self) -> None:
        super()._opened()
        self._requests.clear()


class _AsOnALine:
    """The messages of a connection as the frames of a serial line; other bytes are dropped."""

    def __init__(self, inner: ByteStream) -> None:
        self._inner = inner
        self._number = 0
        self._begun = b""
        """Of a message that is not whole yet."""

    @property
    def is_open(self) -> bool:
        return self._inner.is_open

    async def open(self, timeout_s: float) -> None:
        self._begun = b""
        await self._inner.open(timeout_s)

    async def close(self) -> None:
        await self._inner.close()

    def write(self, data: bytes) -> None:
        """data: one frame"""
        unit, message = data[0], data[1:-2]
        self._number = (self._number + 1) % _NUMBERS
        self._inner.write(TCP_HEADER.pack(self._number, 0, len(message) + 1, unit) + message)

    async def read(self, timeout_s: float) -> bytes:
        return self._frames(await self._inner.read(timeout_s))

    def discard(self) -> bytes:
        return self._frames(self._inner.discard())

    def _frames(self, data: bytes) -> bytes:
        messages, end = tcp_messages(heard := self._begun + data)
        self._begun = heard[end:] if begins_message(heard[end:]) else b""
        return b"".join(rtu_frame(bytes((unit,)) + message) for _, unit, message in messages)
