"""One request to an MTConnect agent by HTTP, and the body of its answer."""

import asyncio
import http.client
import socket
from contextlib import suppress
from urllib.parse import urlsplit

from drivers.base import BadAnswer, ConnectError, NoAnswer
from drivers.mtconnect.document import AgentError, elements

MOST_BYTES = 8_000_000
"""Of one answer."""


async def ask_agent(url: str, machine: str, request: str, timeout_s: float) -> bytes:
    """The body of the answer to `probe` or `current` within `timeout_s` seconds; `machine` empty: of all machines.

    Raises NoAnswer, ConnectError, and BadAnswer: another HTTP status than 200, or more than MOST_BYTES.
    """
    exchange = _Exchange(url, f"/{machine}/{request}" if machine else f"/{request}")
    try:
        async with asyncio.timeout(timeout_s):
            status, body = await asyncio.to_thread(exchange.run, timeout_s)
    except TimeoutError as error:
        raise NoAnswer(f"{url}: no answer to {request} within {timeout_s:g} s", device="nc") from error
    except (OSError, http.client.HTTPException, ValueError, OverflowError) as error:  # ValueError: of a chunk's size
        raise ConnectError(f"{url}: {str(error) or type(error).__name__}", device="nc") from error
    finally:
        exchange.hang_up()
    if len(body) > MOST_BYTES:
        raise BadAnswer(f"{request}: more than {MOST_BYTES} bytes", device="nc")
    if status != http.HTTPStatus.OK:
        raise BadAnswer(f"{request}: HTTP status {status}{_why(body)}", device="nc", hint="see url and machine")
    return body


class _Exchange:
    """One request and its answer, on a connection of its own, in a thread of its own."""

    def __init__(self, url: str, path: str) -> None:
        parts = urlsplit(url)
        self._host, self._port = parts.hostname or "", parts.port or http.client.HTTP_PORT
        self._path = parts.path.rstrip("/") + path
        self._socket: socket.socket | None = None
        self._hung_up = False

    def run(self, timeout_s: float) -> tuple[int, bytes]:
        """HTTP status and body, at most one byte more than MOST_BYTES. Blocks."""
        connection = http.client.HTTPConnection(self._host, self._port, timeout=timeout_s)
        try:
            connection.connect()
            self._socket = connection.sock
            if self._hung_up:
                raise TimeoutError
            connection.request("GET", self._path, headers={"Accept": "text/xml", "Connection": "close"})
            response = connection.getresponse()
            return response.status, response.read(MOST_BYTES + 1)
        finally:
            connection.close()

    def hang_up(self) -> None:
        """Ends a thread that still reads: an agent that sends a byte a second would keep it for ever."""
        self._hung_up = True
        if self._socket is not None:
            with suppress(OSError):  # it has ended
                self._socket.shutdown(socket.SHUT_RDWR)


def _why(body: bytes) -> str:
    """What an MTConnect agent says of its refusal."""
    try:
        elements(body)
    except AgentError as error:
        return f", {error}"
    except ValueError:
        pass
    return ""
