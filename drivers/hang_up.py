"""Ends another thread's wait on a connection: a peer that sends a byte a second would keep it waiting forever."""

import socket
from contextlib import suppress


class HangUp:
    """Hangs up one connection. `now` may be called from any thread, also before there is a connection."""

    def __init__(self) -> None:
        self.done = False
        """Whether it was ended."""
        self._line: socket.socket | None = None

    def take(self, line: socket.socket) -> None:
        """The connection is there. Raises TimeoutError if it is no longer wanted."""
        self._line = line
        if self.done:
            raise TimeoutError

    def now(self) -> None:
        """End it: reading and writing fail from now on."""
        self.done = True
        if self._line is not None:
            with suppress(OSError):  # it has ended
                socket.socket.shutdown(self._line, socket.SHUT_RDWR)  # a TLS socket's own is not for another thread
