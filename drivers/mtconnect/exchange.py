"""One request to an MTConnect agent by HTTP, and the body of its answer."""

import asyncio
import http.client
from urllib.parse import urlsplit

from drivers.base import BadAnswer, ConnectError, NoAnswer
from drivers.error_words import in_words
from drivers.hang_up import HangUp
from drivers.mtconnect.document import AgentError, elements
from drivers.text import NOTHING, Text, text_of

_MOST_BYTES = 8_000_000
"""Largest size of one answer."""


async def ask_agent(url: str, machine: str, request: str, timeout_s: float) -> bytes:
    """The body of the answer to `probe` or `current` within `timeout_s` seconds; `machine` empty: of all machines.

    Raises NoAnswer, ConnectError, and BadAnswer: another HTTP status than 200, or more than _MOST_BYTES.
    """
    exchange = _Exchange(url, f"/{machine}/{request}" if machine else f"/{request}")
    try:
        async with asyncio.timeout(timeout_s):
            status, body = await asyncio.to_thread(exchange.run, timeout_s)
    except TimeoutError as error:
        raise NoAnswer(Text("mtc_silent", url=url, request=request, timeout_s=timeout_s), device="nc") from error
    except (OSError, http.client.HTTPException, ValueError, OverflowError) as error:  # ValueError: of a chunk's size
        raise ConnectError(Text("mtc_failed", url=url, why=in_words(error)), device="nc") from error
    finally:
        exchange.hang_up.now()
    if len(body) > _MOST_BYTES:
        raise BadAnswer(Text("mtc_long", request=request, most=_MOST_BYTES), device="nc")
    if status != http.HTTPStatus.OK:
        why = await asyncio.to_thread(_why, body)
        said = Text("mtc_status", request=request, status=status)
        if why:
            said = Text("mtc_status_why", request=request, status=status, why=why)
        raise BadAnswer(said, device="nc", hint=Text("mtc_check"))
    return body


class _Exchange:
    """One request and its answer, on its own connection and in its own thread."""

    def __init__(self, url: str, path: str) -> None:
        parts = urlsplit(url)
        self._host, self._port = parts.hostname or "", parts.port or http.client.HTTP_PORT
        self._path = parts.path.rstrip("/") + path
        self.hang_up = HangUp()

    def run(self, timeout_s: float) -> tuple[int, bytes]:
        """HTTP status and body, at most one byte more than _MOST_BYTES. Blocks."""
        connection = http.client.HTTPConnection(self._host, self._port, timeout=timeout_s)
        try:
            connection.connect()
            self.hang_up.take(connection.sock)
            connection.request("GET", self._path, headers={"Accept": "text/xml", "Connection": "close"})
            with connection.getresponse() as response:  # else what it has not read keeps the socket open
                return response.status, response.read(_MOST_BYTES + 1)
        finally:
            connection.close()


def _why(body: bytes) -> Text:
    """What an MTConnect agent says of its refusal."""
    try:
        elements(body)
    except AgentError as error:
        return text_of(error)
    except ValueError:
        pass
    return NOTHING
