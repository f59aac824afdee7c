"""A serial port of a device server on the network: raw TCP (`socket://`), or with its speed and parity set (`rfc2217://`).

Source: RFC 2217, Telnet Com Port Control Option. pyserial speaks it, with a thread that reads the connection and calls
that wait; here its calls run in threads too, so that nothing waits in the event loop.
"""

import asyncio
import socket
import threading
from contextlib import suppress

from serial import rfc2217

from drivers.base import ConnectError
from drivers.bus_settings import SerialSettings
from drivers.byte_stream import CLOSED, ByteStream, Inbox, SerialStream, TcpStream, notice_dead_peer
from drivers.error_words import in_words
from drivers.section import without_brackets
from drivers.tap import Tap
from drivers.text import Text

SERVER_PAUSE_S = 0.1
"""A device server sends on what it receives in pieces."""
_PAUSE_S = 0.02
_LOOK_S = 0.5
"""How long the thread that reads waits for a byte before it looks whether the port is still open."""


def serial_stream(bus: str, settings: SerialSettings, tap: Tap | None = None) -> ByteStream:
    """The stream of a serial port of this computer, or of a device server."""
    if not settings.is_remote:
        return SerialStream(bus, settings, tap)
    if settings.port.startswith("rfc2217:"):
        return Rfc2217Stream(bus, settings, tap)
    host, _, port = settings.port.removeprefix("socket://").rstrip("/").rpartition(":")
    return TcpStream(bus, without_brackets(host), int(port), tap)


def pause_s(settings: SerialSettings) -> float:
    """After a pause of this length on the port, what was being sent has ended."""
    return SERVER_PAUSE_S if settings.is_remote else _PAUSE_S


class _DeviceServerPort(rfc2217.Serial):
    """A port whose connection ends a few seconds after its server has gone."""

    _socket: socket.socket | None

    def open(self) -> None:
        super().open()
        if self._socket is not None:
            notice_dead_peer(self._socket)

    def _telnet_read_loop(self) -> None:
        """The read loop of pyserial's thread. What no server should send, such as the end of a subnegotiation that has
        not begun, is an error there, and so is a server that leaves during an answer. The error ends the connection,
        and its user is told so.
        """
        with suppress(TypeError, OSError):
            super()._telnet_read_loop()  # type: ignore[misc]

    def close(self) -> None:
        connection = self._socket
        super().close()  # leaves the socket open when the server has closed the connection
        if connection is not None:
            connection.close()


class Rfc2217Stream:
    """A port of a device server that takes speed, parity and stop bits from the client."""

    def __init__(self, bus: str, settings: SerialSettings, tap: Tap | None = None) -> None:
        self._bus, self._settings = bus, settings
        self._inbox = Inbox(bus, tap)
        self._port: _DeviceServerPort | None = None
        self._reader: threading.Thread | None = None

    @property
    def is_open(self) -> bool:
        return self._port is not None and self._inbox.lost is None

    async def open(self, timeout_s: float) -> None:  # noqa: ARG002 - pyserial has its own limits, 5 s and 3 s
        await self.close()
        loop = asyncio.get_running_loop()
        opening = loop.run_in_executor(None, self._opened)
        try:
            self._port = await asyncio.shield(opening)
        except asyncio.CancelledError:
            opening.add_done_callback(_close_unwanted)
            raise
        except (OSError, ValueError) as error:
            raise ConnectError(
                Text("port_not_open", port=self._settings.port, why=in_words(error)),
                bus=self._bus,
                hint=Text("check_port_server"),
            ) from error
        self._inbox.opened()
        self._reader = threading.Thread(
            target=self._read, args=(self._port, loop), name=f"rfc2217 {self._bus}", daemon=True
        )
        self._reader.start()

    def _opened(self) -> _DeviceServerPort:
        s = self._settings
        url = s.port.rstrip("/") + "?ign_set_control"  # some servers do not answer what is said of DTR and RTS
        return _DeviceServerPort(url, baudrate=s.baud, parity=s.parity, stopbits=s.stopbits, timeout=_LOOK_S)

    async def close(self) -> None:
        if self._port is None:
            return
        (port, self._port), (reader, self._reader) = (self._port, None), (self._reader, None)
        self._inbox.lose(CLOSED)
        await asyncio.to_thread(port.close)
        if reader is not None:
            await asyncio.to_thread(reader.join)

    def write(self, data: bytes) -> None:
        self._inbox.check()
        if self._port is None:
            raise ConnectError(CLOSED, bus=self._bus)
        self._inbox.sent(data)
        try:
            self._port.write(data)  # a request fits into the socket's buffer, so that this does not wait
        except OSError as error:
            self._inbox.lose(Text("port_gone", port=self._settings.port, why=in_words(error)))
            self._inbox.check()

    async def read(self, timeout_s: float) -> bytes:
        return await self._inbox.take(timeout_s)

    def discard(self) -> bytes:
        return self._inbox.discard()

    def _read(self, port: _DeviceServerPort, loop: asyncio.AbstractEventLoop) -> None:
        """Runs in a thread, until the port is closed or lost."""
        with suppress(RuntimeError):  # the event loop has ended
            try:
                while True:
                    if data := port.read(max(1, port.in_waiting)):
                        loop.call_soon_threadsafe(self._heard, port, data)
            except OSError as error:
                loop.call_soon_threadsafe(self._lost, port, in_words(error))

    def _heard(self, port: _DeviceServerPort, data: bytes) -> None:
        if self._port is port:
            self._inbox.put(data)

    def _lost(self, port: _DeviceServerPort, reason: str) -> None:
        if self._port is port:
            self._inbox.lose(Text("port_gone", port=self._settings.port, why=reason))


def _close_unwanted(opening: "asyncio.Future[_DeviceServerPort]") -> None:
    """Close what was opened for somebody who no longer waits for it."""
    if not opening.cancelled() and opening.exception() is None:
        threading.Thread(target=opening.result().close, daemon=True).start()
