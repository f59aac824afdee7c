"""A byte stream to one peer, over a serial port or a TCP connection, with a deadline on every wait."""

import asyncio
import errno
import os
import socket
import termios
from collections.abc import Callable
from contextlib import suppress
from typing import Protocol

import serial
from serial.rs485 import RS485Settings

from drivers.base import ConnectError
from drivers.bus_settings import SerialSettings
from drivers.error_words import error_number, in_words
from drivers.section import host_and_port
from drivers.tap import Tap
from drivers.text import Text

_READ_SIZE = 4096
_MOST_UNREAD = 65536
CLOSED = Text("not_connected")
"""Why nothing comes: it is not open."""
_TAKEN = Text("port_taken")


class ByteStream(Protocol):
    """The byte stream of a bus. It has one user at a time."""

    @property
    def is_open(self) -> bool: ...

    async def open(self, timeout_s: float) -> None:
        """Open the stream. Raises ConnectError."""
        ...

    async def close(self) -> None: ...

    def write(self, data: bytes) -> None:
        """Send the bytes. Raises ConnectError when the connection is lost."""
        ...

    async def read(self, timeout_s: float) -> bytes:
        """Receive at least one byte. Raises TimeoutError, or ConnectError when the connection is lost."""
        ...

    def discard(self) -> bytes:
        """Discard unread bytes, and return them."""
        ...


class StreamBus:
    """A bus on one byte stream; requests queue up behind its lock.

    Parameters
    ----------
    name: in the configuration
    stream: opened by `connect`
    timeout_s: how long one answer, or opening the stream, may take at most
    """

    def __init__(self, name: str, stream: ByteStream, timeout_s: float) -> None:
        self._name, self._stream, self._timeout_s = name, stream, timeout_s
        self._lock = asyncio.Lock()

    @property
    def name(self) -> str:
        return self._name

    @property
    def timeout_s(self) -> float:
        return self._timeout_s

    async def connect(self) -> None:
        """Open the stream, unless it is already open. Raises ConnectError."""
        async with self._lock:
            if not self._stream.is_open:
                await self._open()

    async def close(self) -> None:
        async with self._lock:
            await self._stream.close()

    async def _open(self) -> None:
        await self._stream.open(self._timeout_s)


class Inbox:
    """The received bytes, and the one task that waits for them."""

    def __init__(self, bus: str, tap: Tap | None) -> None:
        self._bus, self._tap = bus, tap
        self._bytes = bytearray()
        self._waiter: asyncio.Future[None] | None = None
        self._lost: str | None = CLOSED

    @property
    def lost(self) -> str | None:
        return self._lost

    def opened(self) -> None:
        self._lost = None
        self._bytes.clear()
        if self._tap is not None:
            self._tap.note("open")

    def lose(self, reason: str) -> None:
        if self._lost is None:
            self._lost = reason
            if self._tap is not None:
                self._tap.note("close" if reason == CLOSED else f"lost {reason}")
        self._wake()

    def put(self, data: bytes) -> None:
        if self._tap is not None:
            self._tap.data(False, data)
        self._bytes += data
        if len(self._bytes) > _MOST_UNREAD:  # a line that never stops sending must not fill the memory
            del self._bytes[:-_MOST_UNREAD]
        self._wake()

    async def take(self, timeout_s: float) -> bytes:
        if not self._bytes:
            self.check()
            if timeout_s <= 0:
                raise TimeoutError
            loop = asyncio.get_running_loop()
            self._waiter = loop.create_future()
            end = loop.call_later(timeout_s, self._wake)
            try:
                await self._waiter
            finally:
                end.cancel()
                self._waiter = None
            if not self._bytes:  # bytes count if they came in time, even if the event loop was too busy to see them
                self.check()
                raise TimeoutError
        data = bytes(self._bytes)
        self._bytes.clear()
        return data

    def check(self) -> None:
        """Raise ConnectError when the connection is lost."""
        if self._lost is not None:
            raise ConnectError(self._lost, bus=self._bus, hint=Text("connect_bus_again"))

    def discard(self) -> bytes:
        data = bytes(self._bytes)
        self._bytes.clear()
        return data

    def sent(self, data: bytes) -> None:
        """Report the bytes that are sent to the tap."""
        if self._tap is not None:
            self._tap.data(True, data)

    def _wake(self) -> None:
        if self._waiter is not None and not self._waiter.done():
            self._waiter.set_result(None)


class SerialStream:
    """A serial port, read by the event loop: no thread and no polling."""

    def __init__(self, bus: str, settings: SerialSettings, tap: Tap | None = None) -> None:
        self._bus, self._settings = bus, settings
        self._inbox = Inbox(bus, tap)
        self._port: serial.Serial | None = None

    @property
    def is_open(self) -> bool:
        return self._port is not None and self._inbox.lost is None

    async def open(self, timeout_s: float) -> None:  # noqa: ARG002 - opening a port does not wait
        await self.close()
        s = self._settings
        try:
            self._port = serial.Serial(
                s.port, baudrate=s.baud, parity=s.parity, stopbits=s.stopbits, timeout=0, exclusive=True
            )
        except (OSError, ValueError, termios.error) as error:
            raise ConnectError(
                Text("port_not_open", port=s.port, why=in_words(error)),
                bus=self._bus,
                hint=serial_port_hint(error, s.parity) or Text("check_port"),
            ) from error
        self._switch_direction(self._port)
        self._inbox.opened()
        asyncio.get_running_loop().add_reader(self._port.fileno(), self._on_readable, self._port.fileno())

    def _switch_direction(self, port: serial.Serial) -> None:
        """Have the port's driver switch the direction of RS-485. Raises ConnectError, and closes the port."""
        s = self._settings
        if s.rs485_rts is None:
            return
        high = s.rs485_rts == "high"
        try:
            port.rs485_mode = RS485Settings(
                rts_level_for_tx=high,
                rts_level_for_rx=not high,
                delay_before_tx=s.rs485_before_s,
                delay_before_rx=s.rs485_after_s,
            )
        except (OSError, ValueError) as error:
            self._port = None
            port.close()
            raise ConnectError(
                Text("port_no_rts", port=s.port, rs485_rts=repr(s.rs485_rts), why=in_words(error)),
                bus=self._bus,
                hint=Text("omit_rts"),
            ) from error

    async def close(self) -> None:
        if self._port is None:
            return
        port, self._port = self._port, None
        self._inbox.lose(CLOSED)
        asyncio.get_running_loop().remove_reader(port.fileno())
        with suppress(OSError, termios.error):  # an unplugged adapter no longer accepts commands
            port.close()

    def write(self, data: bytes) -> None:
        self._inbox.check()
        if self._port is None:
            raise ConnectError(CLOSED, bus=self._bus)
        self._inbox.sent(data)
        try:
            written = os.write(self._port.fileno(), data)
        except OSError as error:
            self._inbox.lose(Text("port_gone", port=self._settings.port, why=in_words(error)))
            self._inbox.check()
        else:
            if written < len(data):
                self._inbox.lose(Text("port_full", port=self._settings.port))
                self._inbox.check()

    async def read(self, timeout_s: float) -> bytes:
        return await self._inbox.take(timeout_s)

    def discard(self) -> bytes:
        return self._inbox.discard()

    def _on_readable(self, descriptor: int) -> None:
        try:
            data = os.read(descriptor, _READ_SIZE)
        except BlockingIOError:
            return
        except OSError as error:
            data, reason = b"", in_words(error)
        else:
            reason = Text("hung_up")
        if data:
            self._inbox.put(data)
        else:
            asyncio.get_running_loop().remove_reader(descriptor)
            self._inbox.lose(Text("port_gone", port=self._settings.port, why=reason))


def serial_port_hint(error: Exception, parity: str = "N") -> str:
    """What to do about this error when a serial port does not open; empty when unknown."""
    match error_number(error):
        case errno.EAGAIN:
            return _TAKEN
        case errno.ENOENT:
            return Text("port_absent")
        case errno.EACCES:
            return Text("join_dialout")
        case errno.ENOTTY | errno.EISDIR | errno.ENXIO:
            return Text("no_serial_port")
        case errno.EINVAL if parity != "N":
            return Text("no_parity")
    return ""


class TcpStream:
    """A TCP connection. The kernel closes it after a few seconds without an acknowledgement."""

    def __init__(self, bus: str, host: str, port: int, tap: Tap | None = None) -> None:
        self._bus, self._host, self._tcp_port = bus, host, port
        self._inbox = Inbox(bus, tap)
        self._transport: asyncio.Transport | None = None

    @property
    def is_open(self) -> bool:
        return self._transport is not None and self._inbox.lost is None

    async def open(self, timeout_s: float) -> None:
        await self.close()
        loop = asyncio.get_running_loop()
        try:
            async with asyncio.timeout(timeout_s):
                transport, _ = await loop.create_connection(
                    lambda: _TcpProtocol(self._inbox.put, self._inbox.lose), self._host, self._tcp_port
                )
        except TimeoutError as error:
            raise ConnectError(
                Text("host_silent", address=host_and_port(self._host, self._tcp_port), timeout_s=timeout_s),
                bus=self._bus,
                hint=Text("check_power"),
            ) from error
        except (OSError, UnicodeError) as error:
            why = Text("no_host_name") if isinstance(error, UnicodeError) else in_words(error)
            raise ConnectError(
                Text("host_refuses", address=host_and_port(self._host, self._tcp_port), why=why),
                bus=self._bus,
                hint=Text("check_host"),
            ) from error
        notice_dead_peer(transport.get_extra_info("socket"))
        self._transport = transport
        self._inbox.opened()

    async def close(self) -> None:
        if self._transport is None:
            return
        transport, self._transport = self._transport, None
        self._inbox.lose(CLOSED)
        transport.abort()
        await asyncio.sleep(0)  # lets the loop close the socket

    def write(self, data: bytes) -> None:
        self._inbox.check()
        if self._transport is None:
            raise ConnectError(CLOSED, bus=self._bus)
        self._inbox.sent(data)
        self._transport.write(data)

    async def read(self, timeout_s: float) -> bytes:
        return await self._inbox.take(timeout_s)

    def discard(self) -> bytes:
        return self._inbox.discard()


class _TcpProtocol(asyncio.Protocol):
    def __init__(self, put: Callable[[bytes], None], lose: Callable[[str], None]) -> None:
        self._put, self._lose = put, lose

    def data_received(self, data: bytes) -> None:
        self._put(data)

    def connection_lost(self, exc: Exception | None) -> None:
        self._lose(Text("connection_lost", why=in_words(exc)) if exc else Text("device_hung_up"))


def notice_dead_peer(sock: socket.socket) -> None:
    """Have the kernel close a connection after a few seconds without an acknowledgement, and send at once."""
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, 5)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, 2)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPCNT, 3)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, 8000)
