"""The kernel's raw CAN sockets as python-can sees them, on computers without CAN: frames and errors of linux/can.h."""

import errno
import os
import socket
import struct
from collections.abc import Callable, Sequence

from simulators.devices.slcan_adapter import CanFrame, CanNode

_FRAME = struct.Struct("=IB3x8s")
_TIMESPEC = struct.Struct("@ll")
_SO_TIMESTAMPNS = 35


def _error(number: int) -> OSError:
    return OSError(number, os.strerror(number))


class CanSocket:
    """One raw socket. A closed one is recognised by `closed`."""

    def __init__(self, kernel: "CanKernel") -> None:
        self._kernel = kernel
        self._queue, self._inside = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._pending = 0
        self.options: dict[tuple[int, int], int | bytes] = {}
        self.channel = ""
        self.closed = False

    def setsockopt(self, level: int, option: int, value: int | bytes) -> None:
        self.options[level, option] = value

    def getsockopt(self, level: int, option: int) -> int:
        assert (level, option) == (socket.SOL_SOCKET, socket.SO_ERROR)
        pending, self._pending = self._pending, 0
        return pending

    def bind(self, address: tuple[str]) -> None:
        (self.channel,) = address
        if self.channel not in self._kernel.up:
            raise _error(errno.ENODEV)
        if not self._kernel.up[self.channel]:  # bound all the same, as the kernel does
            self._pending = errno.ENETDOWN

    def fileno(self) -> int:
        return self._queue.fileno()

    def send(self, frame: bytes) -> int:
        if self._kernel.refuses_to_send:
            raise _error(self._kernel.refuses_to_send)
        if self.channel not in self._kernel.up:
            raise _error(errno.ENXIO)
        if not self._kernel.up[self.channel]:
            raise _error(errno.ENETDOWN)
        identifier, size, data = _FRAME.unpack(frame)
        self._kernel.pass_on(self.channel, identifier, data[:size])
        return len(frame)

    def recvmsg(self, size: int, _: int) -> tuple[bytes, list[tuple[int, int, bytes]], int, tuple[str]]:
        frame = self._queue.recv(size)
        if pending := self.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
            raise _error(pending)
        return frame, [(socket.SOL_SOCKET, _SO_TIMESTAMPNS, _TIMESPEC.pack(0, 0))], 0, (self.channel,)

    def close(self) -> None:
        self.closed = True
        self._queue.close()
        self._inside.close()

    def put(self, frame: bytes) -> None:
        self._inside.send(frame)

    def fail(self, number: int) -> None:
        """Fail, as the kernel wakes whoever waits."""
        self._pending = number
        self._inside.send(b"")


class CanKernel:
    """Interfaces with nodes on them. `create` takes the place of python-can's `create_socket`."""

    def __init__(self, nodes: Sequence[CanNode] = (), channel: str = "can0") -> None:
        self._nodes = nodes
        self.up = {channel: True}
        """The interfaces, and whether they are up."""
        self.refuses: int = 0
        """The error number that a request for a socket gets."""
        self.refuses_to_send: int = 0
        self.sockets: list[CanSocket] = []

    def create(self) -> CanSocket:
        if self.refuses:
            raise _error(self.refuses)
        self.sockets.append(CanSocket(self))
        return self.sockets[-1]

    def switch(self, channel: str, *, on: bool) -> None:
        """`ip link set can0 up`, or down."""
        self.up[channel] = on
        if not on:
            self._each(channel, lambda open_one: open_one.fail(errno.ENETDOWN))

    def remove(self, channel: str) -> None:
        """Pull the adapter out."""
        del self.up[channel]
        self._each(channel, lambda open_one: open_one.fail(errno.ENODEV))

    def send(self, frames: Sequence[CanFrame], channel: str = "can0") -> None:
        """Frames that nodes send; bit 31 of an identifier says that it has 29 bits, as in linux/can.h."""
        for identifier, data in frames:
            frame = _FRAME.pack(identifier, len(data), data.ljust(8, b"\0"))
            self._each(channel, lambda open_one, frame=frame: open_one.put(frame))  # type: ignore[misc]

    def pass_on(self, channel: str, identifier: int, data: bytes) -> None:
        """Pass what a socket sent to the nodes, and their answers back."""
        for node in self._nodes:
            self.send(node.on_frame(identifier, data), channel)

    def _each(self, channel: str, do: Callable[[CanSocket], None]) -> None:
        for open_one in self.sockets:
            if open_one.channel == channel and not open_one.closed:
                do(open_one)
