"""Outlet to InfluxDB, or to what takes its line protocol by HTTP."""

import json
import socket
from base64 import b64encode
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from http.client import HTTPConnection, HTTPException, HTTPResponse, HTTPSConnection, IncompleteRead
from threading import Timer
from typing import ClassVar, Literal, Self
from urllib.parse import urlencode

from pydantic import Field, model_validator

from drivers.credential_files import secret_in, trust_in
from drivers.hang_up import HangUp
from drivers.section import FilePath, NotEmpty, NotNegative, user_and_password
from drivers.server_url import UrlServer
from gateway.listeners.outlets.line_protocol import WRITTEN, lines
from gateway.listeners.outlets.outlet import OutletError, OutletMessage, OutletSettings, Unacceptable
from gateway.model.codes import NoticeCode
from gateway.model.text import Text

_MOST_SHOWN = 300
_MOST_BYTES = 65_536
"""Largest size of an answer."""


class InfluxDbSettings(OutletSettings, UrlServer):
    """InfluxDB 2 (`bucket`) or 1 (`database`), by HTTP."""

    schemes: ClassVar[tuple[str, str]] = ("https", "http")
    default_ports: ClassVar[tuple[int, int]] = (8086, 8086)

    kind: Literal["influxdb"]
    """`influxdb`."""
    url: str
    """The server, such as `https://influx.plant.example:8086`. The default port is 8086."""
    bucket: NotEmpty | None = None
    """Bucket of InfluxDB 2; with `org` and `token_file`."""
    org: NotEmpty | None = None
    """Organisation of InfluxDB 2."""
    token_file: FilePath | None = None
    """File that contains only a token that may write to the bucket."""
    database: NotEmpty | None = None
    """Database of InfluxDB 1, instead of a bucket."""
    user: NotEmpty | None = None
    """User of InfluxDB 1."""
    password_file: FilePath | None = None
    """File that contains only the user's password."""
    gather_for_s: NotNegative = 5.0
    """Send lines together that come within this time."""
    lines_at_once: int = Field(default=1000, ge=1, le=10_000)
    """Send as soon as this many messages wait."""

    @model_validator(mode="after")
    def _sensible(self) -> Self:
        if (self.bucket is None) == (self.database is None):
            raise ValueError(Text(NoticeCode.INFLUXDB_WHICH))
        if self.database is not None and (self.org or self.token_file):
            raise ValueError(Text(NoticeCode.INFLUXDB_OF_TWO))
        if self.bucket is not None and (self.user or self.password_file):
            raise ValueError(Text(NoticeCode.INFLUXDB_OF_ONE))
        user_and_password(self.user, self.password_file)
        return self

    @property
    def batch(self) -> int:
        return self.lines_at_once

    @property
    def gather_s(self) -> float:
        return self.gather_for_s

    @property
    def possible(self) -> frozenset[str]:
        return WRITTEN

    def outlet(self) -> "InfluxDbOutlet":
        return InfluxDbOutlet(self)


class InfluxDbOutlet:
    """Writes lines to one server, over one connection while the server keeps it."""

    def __init__(self, settings: InfluxDbSettings) -> None:
        """Raises SetupError for files that cannot be used."""
        self._settings = settings
        asked = {"precision": "ns"}
        self._headers = {"Content-Type": "text/plain; charset=utf-8"}
        if settings.bucket is not None:
            asked |= {"bucket": settings.bucket} | ({} if settings.org is None else {"org": settings.org})
            self._path = "/api/v2/write?" + urlencode(asked)
            if settings.token_file is not None:
                self._headers["Authorization"] = f"Token {secret_in('token_file', settings.token_file)}"
        else:
            asked["db"] = settings.database or ""
            if settings.user is not None and settings.password_file is not None:
                login = f"{settings.user}:{secret_in('password_file', settings.password_file)}"
                self._headers["Authorization"] = f"Basic {b64encode(login.encode()).decode()}"
            self._path = "/write?" + urlencode(asked)
        self._tls = trust_in(settings.authority) if settings.encrypted else None
        self._connection: HTTPConnection | None = None

    def open(self) -> None:
        """Do nothing: an absent server is noticed at the first line."""

    def send(self, batch: Sequence[OutletMessage]) -> None:
        """Write these. Raises OutletError, and Unacceptable for lines that the server will never take."""
        body = "\n".join(line for told in batch for line in lines(told))
        if not body:
            return
        try:
            answer, said = self._posted(body.encode())
        except (OSError, HTTPException, ValueError, OverflowError) as error:  # the last two: absurd sizes in an answer
            self.close()
            raise OutletError(f"{self._settings.url}: {str(error) or type(error).__name__}") from error
        if answer.status // 100 == 2:
            return
        text = f"{self._settings.url}: {answer.status} {answer.reason}: {_explained(said)}"
        if answer.status in (400, 413, 422):  # malformed, too large, or of another type than what is stored
            raise Unacceptable(text)
        self.close()
        raise OutletError(text)

    def close(self) -> None:
        """Close the connection; the next line opens another."""
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def _posted(self, body: bytes) -> tuple[HTTPResponse, bytes]:
        kept = self._connection is not None
        try:
            return self._asked(body)
        except (ConnectionError, HTTPException):
            if not kept:
                raise
            self.close()  # the server had closed the connection meanwhile; a line that is written twice stays one
            return self._asked(body)

    def _asked(self, body: bytes) -> tuple[HTTPResponse, bytes]:
        if self._connection is None:
            host, port, limit_s = self._settings.host, self._settings.port, self._settings.timeout_s
            if self._tls is not None:
                self._connection = HTTPSConnection(host, port, timeout=limit_s, context=self._tls)
            else:
                self._connection = HTTPConnection(host, port, timeout=limit_s)
        connection = self._connection
        if connection.sock is None:
            connection.connect()
        with _hung_up_after(self._settings.timeout_s, connection.sock):
            connection.request("POST", self._path, body, self._headers)
            with connection.getresponse() as answer:
                said = answer.read(_MOST_BYTES + 1)
        if len(said) > _MOST_BYTES:
            raise ValueError(f"an answer of more than {_MOST_BYTES} bytes")
        if answer.length:
            raise IncompleteRead(said, answer.length)
        return answer, said


@contextmanager
def _hung_up_after(limit_s: float, line: socket.socket) -> Iterator[None]:
    """Inside, end a request that takes longer than this. Raises TimeoutError."""
    hang_up = HangUp()
    hang_up.take(line)
    timer = Timer(limit_s, hang_up.now)
    timer.daemon = True
    timer.start()
    try:
        yield
    except (OSError, HTTPException, ValueError):
        if not hang_up.done:
            raise
    finally:
        timer.cancel()
    if hang_up.done:
        raise TimeoutError(f"no complete answer within {limit_s:g} s")


def _explained(said: bytes) -> str:
    """What the server says, which is JSON with a message if it is InfluxDB."""
    text = said.decode(errors="replace").strip()
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        pass
    else:
        if isinstance(found, dict):
            text = str(found.get("message") or found.get("error") or text)
    return text[:_MOST_SHOWN]
