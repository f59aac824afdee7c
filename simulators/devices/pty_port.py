"""The device's end of a serial line: a pseudo-terminal in raw mode, read by the event loop."""

import asyncio
import fcntl
import os
import pty
import struct
import termios
import tty
from collections.abc import Callable

_TCGETS2 = 0x802C542A
_TERMIOS2 = struct.Struct("<4IB19sII")
"""Flags, line discipline, control characters, input and output speed (asm-generic/termbits.h)."""


class PtyPort:
    """`await start()` gives the path that the other side opens.

    Both ends stay open here, so that a client may come and go, as with a cable that stays plugged in.
    """

    def __init__(self, on_bytes: Callable[[bytes], None]) -> None:
        self._on_bytes = on_bytes
        self._ours: int | None = None
        self._theirs: int | None = None

    async def start(self) -> str:
        self._ours, self._theirs = pty.openpty()
        tty.setraw(self._theirs, termios.TCSANOW)
        os.set_blocking(self._ours, False)
        asyncio.get_running_loop().add_reader(self._ours, self._readable)
        return os.ttyname(self._theirs)

    @property
    def baud(self) -> int:
        """The speed set by whoever has the path open: a pseudo-terminal stores it and carries bytes regardless.

        Raises OSError when not started.
        """
        if self._theirs is None:
            raise OSError("the port is not open")
        state = fcntl.ioctl(self._theirs, _TCGETS2, bytes(_TERMIOS2.size))
        return int(_TERMIOS2.unpack(state)[-1])

    async def stop(self) -> None:
        """Hang up: a client that has the path open reads end of file."""
        if self._ours is None or self._theirs is None:
            return
        asyncio.get_running_loop().remove_reader(self._ours)
        os.close(self._ours)
        os.close(self._theirs)
        self._ours = self._theirs = None

    def write(self, data: bytes) -> None:
        """Send; bytes that do not fit the terminal's buffer because no client reads are lost, as on a wire."""
        if self._ours is not None:
            try:
                os.write(self._ours, data)
            except BlockingIOError:
                return

    def _readable(self) -> None:
        if self._ours is None:
            return
        try:
            data = os.read(self._ours, 4096)
        except (BlockingIOError, OSError):
            return
        self._on_bytes(data)
