"""An emulated USB-CAN adapter with the LAWICEL (slcan) ASCII protocol, and the nodes on its bus."""

from collections.abc import Sequence
from typing import Protocol

from simulators.devices.pty_port import PtyPort
from simulators.devices.spoil import Spoil, send

CanFrame = tuple[int, bytes]
"""Identifier (11 bits; one of 29 bits has 1 << 31 added) and up to 8 data bytes."""

_RATES = (10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 800_000, 1_000_000)
_BITRATES = {b"%d" % number: rate for number, rate in enumerate(_RATES)}
_OK, _ERROR = b"\r", b"\a"
_LONGEST_LINE = 64


class CanNode(Protocol):
    """Something on the CAN bus."""

    def on_frame(self, identifier: int, data: bytes) -> Sequence[CanFrame]:
        """What the node sends when this frame passes."""
        ...


class SlcanAdapter:
    """`await start()` gives the path of its serial port. Frames pass only while the channel is open (`O`).

    bitrate: the nodes' bit rate; at any other rate nothing passes. 0: any
    """

    def __init__(self, nodes: Sequence[CanNode], *, bitrate: int = 0) -> None:
        self._nodes, self._bitrate, self._set = tuple(nodes), bitrate, bitrate
        self._listens_only = False
        self._port = PtyPort(self._on_bytes)
        self._heard = b""
        self._open = False
        self.bus_off = False
        """The controller has left the bus after too many errors: nothing passes, sending is refused."""
        self.spoil: Spoil | None = None
        """What happens to each line with a frame on its way to the computer; the sender is the identifier."""

    async def start(self) -> str:
        return await self._port.start()

    async def stop(self) -> None:
        await self._port.stop()

    def send(self, frames: Sequence[CanFrame]) -> None:
        """Frames that nodes send unasked: boot-up, heartbeat, emergency."""
        if self._open and not self.bus_off and self._set == self._bitrate:
            self._pass(frames)

    def _on_bytes(self, data: bytes) -> None:
        *lines, rest = (self._heard + data).split(b"\r")
        self._heard = rest[-_LONGEST_LINE:]
        for line in lines:
            reply = self._on_line(line)
            if reply:
                self._port.write(reply)

    def _on_line(self, line: bytes) -> bytes:
        match line[:1]:
            case b"":
                return _OK
            case b"O" | b"L":
                self._open, self._listens_only = True, line[:1] == b"L"
                return _OK
            case b"C":
                self._open = False
                return _OK
            case b"S" | b"s" | b"Y" if not self._open:
                if self._bitrate and line[:1] == b"S":
                    self._set = _BITRATES.get(line[1:2], 0)
                return _OK
            case b"t" if self._open and not self.bus_off and not self._listens_only:
                return self._transmit(line)
            case _:
                return _ERROR

    def _transmit(self, line: bytes) -> bytes:
        try:
            identifier, count = int(line[1:4], 16), int(line[4:5])
            data = bytes.fromhex(line[5 : 5 + 2 * count].decode("ascii"))
        except (ValueError, UnicodeDecodeError):
            return _ERROR
        if count > 8 or len(data) != count:
            return _ERROR
        if self._set != self._bitrate:  # no node acknowledges
            return _ERROR
        self._port.write(_OK)
        self._pass([frame for node in self._nodes for frame in node.on_frame(identifier, data)])
        return b""

    def _pass(self, frames: Sequence[CanFrame]) -> None:
        if self.spoil is None:
            self._port.write(b"".join(_line(*frame) for frame in frames))
            return
        for identifier, data in frames:
            send(self._port.write, self.spoil, identifier, _line(identifier, data))


def _line(identifier: int, data: bytes) -> bytes:
    number = f"T{identifier & 0x1FFFFFFF:08X}" if identifier >> 31 else f"t{identifier:03X}"
    return f"{number}{len(data)}{data.hex().upper()}\r".encode("ascii")
