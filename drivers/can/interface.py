"""Opens and closes a CAN interface with python-can, and explains its errors. All calls block.

The classes derive from python-can's: those wait by the wall clock, and two of them stop at the first line or packet
that is not a frame, so a single corrupted byte would cost the whole bus a period.
"""

import errno
import os
import re
import socket
from collections import deque
from contextlib import suppress
from time import monotonic
from typing import Any

import can
from can.interfaces.slcan import slcanBus
from can.interfaces.socketcan import SocketcanBus
from can.interfaces.udp_multicast.bus import UdpMulticastBus
from can.interfaces.udp_multicast.utils import unpack_message
from can.interfaces.virtual import VirtualBus
from serial import Serial

from drivers.base import ConnectError
from drivers.byte_stream import serial_port_hint
from drivers.can.receiver import MonotonicInterface
from drivers.can.settings import CanInterfaceSettings
from drivers.can.tapped import TappedInterface
from drivers.error_words import error_number, in_words
from drivers.tap import Tap
from drivers.text import Text

_SERIAL_WAIT_S = 0.1
"""How long one read of the adapter's port blocks. A shorter time would wake the thread for nothing; a longer one
adds no latency, because an arriving byte ends the wait at once."""

_LINE_END = re.compile(rb"[\r\a]")
_LINE = re.compile(rb"(?:t([0-9A-F]{3})|T([01][0-9A-F]{7}))([0-8])((?:[0-9A-F]{2})*)", re.IGNORECASE)
_LONGEST_LINE = 64
_TIMESTAMP_BYTES = 2


def open_interface(
    bus: str, settings: CanInterfaceSettings, *, listen_only: bool = False, tap: Tap | None = None
) -> can.BusABC:
    """Open the interface. Raises ConnectError.

    listen_only: an slcan adapter then sends nothing, not even acknowledgements; other kinds have no such mode
    """
    try:
        interface = _open(settings, listen_only)
    except (can.CanError, OSError, ValueError, ImportError) as error:
        hint = serial_port_hint(error) if settings.interface == "slcan" else _remedy(settings, error)
        raise ConnectError(
            Text("can_not_open", interface=settings.interface, channel=settings.channel, why=in_words(error)),
            bus=bus,
            hint=hint or Text("can_plugged"),
        ) from error
    if tap is None:
        return interface
    return TappedInterface(interface, tap, echoes=settings.interface == "udp_multicast")


def _open(settings: CanInterfaceSettings, listen_only: bool) -> can.BusABC:
    match settings.interface:
        case "slcan":
            options: dict[str, Any] = {"sleep_after_open": 0.0, "timeout": _SERIAL_WAIT_S}
            return _Slcan(settings.channel, bitrate=settings.bitrate, listen_only=listen_only, **options)
        case "udp_multicast":
            return _Multicast(settings.channel, port=settings.port, hop_limit=0)
        case "socketcan":
            return _Socketcan(settings.channel)
        case _:
            return _Virtual(settings.channel)


def shut(interface: can.BusABC) -> None:
    """Close it, whatever state it is in."""
    with suppress(can.CanError, OSError):  # an unplugged adapter no longer accepts commands
        interface.shutdown()
    port = serial_port(interface)
    with suppress(OSError):
        if port is not None:  # python-can leaves it open if its shutdown fails
            port.close()


def serial_port(interface: can.BusABC) -> Serial | None:
    """The port of a serial adapter, also behind a tap; None: it is another interface."""
    inner = interface.inner if isinstance(interface, TappedInterface) else interface
    return inner.serialPortOrig if isinstance(inner, slcanBus) else None


def interface_error(
    bus: str, device: str, settings: CanInterfaceSettings, error: Exception, hint: str = Text("connect_bus_again")
) -> ConnectError:
    """The error of an interface that was open; `hint` applies when the kernel's error has none."""
    code = "can_full" if error_number(error) == errno.ENOBUFS else "can_gone"
    return ConnectError(
        Text(code, channel=settings.channel, why=in_words(error)),
        bus=bus,
        device=device,
        hint=_remedy(settings, error) or hint,
    )


def _remedy(settings: CanInterfaceSettings, error: Exception) -> str | None:
    """What to do about an error of the kernel's CAN; None for any other error."""
    if settings.interface != "socketcan":
        return None
    channel = settings.channel
    missing = Text("can_not_listed", channel=channel)
    denied = Text("can_denied")
    return {
        errno.ENODEV: missing,
        errno.ENXIO: missing,
        errno.ENETDOWN: Text("can_switch_on", channel=channel, bitrate=settings.bitrate),
        errno.ENOBUFS: Text("can_queue_full"),
        errno.EAFNOSUPPORT: Text("can_no_kernel"),
        errno.EPERM: denied,
        errno.EACCES: denied,
    }.get(error_number(error) or 0)


def slcan_frame(line: bytes) -> can.Message | None:
    """The data frame in one line of the LAWICEL protocol, without its end; None when the line is not a whole frame.

    `tiiildd...` with an identifier of 11 bits or `Tiiiiiiiildd...` with one of 29, length, data; a time stamp of two
    bytes may follow. Remote frames carry no value.
    """
    found = _LINE.fullmatch(line)
    if found is None:
        return None
    short, long, length, digits = found.groups()
    size, data = int(length), bytes.fromhex(digits.decode("ascii"))
    identifier = int(short or long, 16)
    if len(data) - size not in (0, _TIMESTAMP_BYTES) or (short is not None and identifier > 0x7FF):
        return None
    return can.Message(arbitration_id=identifier, is_extended_id=short is None, data=data[:size])


class _Slcan(MonotonicInterface, slcanBus):
    """An adapter with the LAWICEL protocol. It ignores lines that are not frames."""

    def __init__(self, channel: str, **options: Any) -> None:
        self._heard = b""
        self._lines: deque[bytes] = deque()
        super().__init__(channel, **options)

    def set_bitrate(self, bitrate: int, data_bitrate: int | None = None) -> None:
        """The first call that python-can makes on an open port. Nothing is sent if another program has the port."""
        try:
            self.serialPortOrig.exclusive = True
        except OSError:
            self.serialPortOrig.close()
            raise
        super().set_bitrate(bitrate, data_bitrate)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        deadline = None if timeout is None else monotonic() + timeout
        while True:
            while self._lines:
                if (message := slcan_frame(self._lines.popleft())) is not None:
                    return message, False
            port = self.serialPortOrig
            *lines, rest = _LINE_END.split(self._heard + port.read(max(1, port.in_waiting)))
            self._lines.extend(lines)
            self._heard = rest[-_LONGEST_LINE:]  # an adapter that never stops sending must not fill the memory
            if not self._lines and deadline is not None and monotonic() >= deadline:
                return None, False


class _Multicast(MonotonicInterface, UdpMulticastBus):
    """A multicast group, on which any program can send. It ignores packets that are not frames."""

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        received = self._multicast.recv(timeout)
        if received is None:
            return None, False
        try:
            return unpack_message(received[0], replace={"timestamp": received[2]}, check=True), False
        except Exception:  # noqa: BLE001 - unpacking arbitrary bytes can raise anything
            return None, False


class _Socketcan(MonotonicInterface, SocketcanBus):
    """An interface of the kernel. One that is down can still be bound: refuse it here, not at the first frame."""

    def __init__(self, channel: str) -> None:
        try:
            super().__init__(channel)
        except OSError:
            if hasattr(self, "socket"):  # not bound, and python-can leaves it open
                self.socket.close()
            raise
        if number := self.socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
            self.shutdown()
            raise OSError(number, os.strerror(number))


class _Virtual(MonotonicInterface, VirtualBus):
    """A virtual bus inside this process."""
