"""An outlet to programs that take lines of text on TCP: machine, key and message, each batch answered by `ok`."""

import socket
from collections.abc import Sequence
from typing import Literal

from drivers.section import NotEmpty, Port
from gateway.listeners.outlets.outlet import OutletError, OutletMessage, OutletSettings, Unacceptable

LONGEST_ANSWER = 1000


class TextLines:
    """One receiver. Constructed without the network; never retries."""

    def __init__(self, host: str, port: int, timeout_s: float) -> None:
        self._host, self._port, self._timeout_s = host, port, timeout_s
        self._socket: socket.socket | None = None

    def open(self) -> None:
        """Connect. Raises OutletError."""
        try:
            self._socket = socket.create_connection((self._host, self._port), self._timeout_s)
        except OSError as error:
            raise OutletError(f"{self._host}:{self._port}: {error}") from error

    def send(self, batch: Sequence[OutletMessage]) -> None:
        """Send these lines, and wait until the receiver has them. Raises OutletError, Unacceptable."""
        if self._socket is None:
            raise OutletError("not connected; open it first")
        lines = b"".join(
            f"{heard.machine} {heard.suffix} ".encode() + heard.payload + b"\n"
            for heard in batch
            if heard.message is not None
        )
        try:
            self._socket.sendall(lines + b"\n")  # an empty line ends the batch
            answer = b""
            while not answer.endswith(b"\n"):
                if not (more := self._socket.recv(LONGEST_ANSWER)):
                    raise OutletError(f"{self._host}:{self._port}: the connection is lost")
                answer += more
        except OutletError:
            raise
        except OSError as error:
            raise OutletError(f"{self._host}:{self._port}: {error}") from error
        if answer != b"ok\n":
            raise Unacceptable(f"{self._host}:{self._port} answered {answer[:100]!r}")

    def close(self) -> None:
        """Let go of the connection."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None


class TextLinesSettings(OutletSettings):
    """A receiver of lines of text."""

    kind: Literal["text_lines"]
    """`text_lines`."""
    host: NotEmpty
    """Host of the receiver."""
    port: Port = 2002
    """Its TCP port."""

    def outlet(self) -> TextLines:
        return TextLines(self.host, self.port, self.timeout_s)
