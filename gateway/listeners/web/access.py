"""Access to the page: only this computer, or a known user over TLS; and what responses forbid the browser to do."""

import asyncio
import hashlib
import hmac
import logging
import os
import ssl
from base64 import b64decode
from binascii import Error as NotBase64
from collections import OrderedDict
from collections.abc import Callable
from math import ceil
from time import monotonic
from typing import Final

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from drivers.base import SetupError
from drivers.bounded_file import check_bounds
from drivers.bus_settings import is_loopback
from gateway.listeners.web.settings import Tls, WebSettings
from gateway.model.codes import NoticeCode
from gateway.model.text import Text
from gateway.runtime.listening import Peer
from gateway.runtime.passwords import GuessingBrake, matches

HEADERS: Final = {
    "content-security-policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-store",
}
"""Headers of every answer: nothing but this server's own files is loaded, and no script or style within a page is
run."""
_LOOPBACK_NAMES = frozenset({"localhost", "127.0.0.1", "::1"})
_MOST_REMEMBERED = 100
_CHECKS_AT_ONCE = 1
"""Each takes 16 MB; of two at once the brake would not know the other."""

log = logging.getLogger(__name__)


def check_listening(host: str, settings: WebSettings) -> None:
    """Raises SetupError for an address beyond this computer without TLS or without users."""
    if is_loopback(host):
        return
    missing = []
    if settings.tls is None:
        missing.append(Text(NoticeCode.PAGE_TLS))
    if not settings.users and settings.proxy is None:
        missing.append(Text(NoticeCode.PAGE_USERS))
    if missing:
        raise SetupError(Text(NoticeCode.PAGE_OPEN, host=host, missing=missing))


def check_certificate(tls: Tls) -> None:
    """Raises SetupError for files that cannot be used."""
    try:
        check_bounds(tls.certificate, tls.key)
        ssl.create_default_context(ssl.Purpose.CLIENT_AUTH).load_cert_chain(
            tls.certificate, tls.key, password=str
        )  # never asks
    except OSError as error:  # SSLError is one
        raise SetupError(
            Text(
                NoticeCode.PAGE_CERTIFICATE,
                certificate=str(tls.certificate),
                key=str(tls.key),
                why=error.strerror or str(error),
            )
        ) from None


class Guard:
    """ASGI middleware: lets in who may look, and adds the headers to every answer.

    Without users and proxy everybody on this computer may look; then the Host header must be a name of this computer,
    so that no web site can read the page through the operator's browser.

    Parameters
    ----------
    app: what is guarded; it finds the name of a known user in the request's state
    settings: users, proxy, hosts
    known: told the peer of each request that is let in
    """

    def __init__(self, app: ASGIApp, settings: WebSettings, known: Callable[[Peer], None] = lambda _: None) -> None:
        self._app, self._settings, self._tell_known = app, settings, known
        self._hosts = _LOOPBACK_NAMES | {host.lower() for host in settings.hosts}
        self._secret = os.urandom(32)
        self._known: OrderedDict[bytes, None] = OrderedDict()
        """Digests of what was found right: a stream and its files are not hashed for seconds again and again."""
        self._brake = GuessingBrake()
        self._checks = asyncio.Semaphore(_CHECKS_AT_ONCE)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer, or refuse."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for key, value in HEADERS.items():
                    headers.setdefault(key, value)
            await send(message)

        refused = await self._refusal(scope)
        if refused is None and (client := scope.get("client")) is not None:
            self._tell_known((client[0], client[1]))
        await (refused or self._app)(scope, receive, with_headers)

    async def _refusal(self, scope: Scope) -> PlainTextResponse | None:
        headers, settings = Headers(scope=scope), self._settings
        if not self._is_method_of(scope):
            return PlainTextResponse("This page is read-only.", 405, {"allow": "GET, HEAD"})
        if not settings.users and settings.proxy is None:
            if _host_name(headers.get("host", "")) in self._hosts:
                return None
            return PlainTextResponse("This name is not among `hosts` of the page's settings.", 421)
        client = scope.get("client")
        if settings.proxy is not None and client is not None and client[0] in settings.proxy.addresses:
            named = headers.getlist(settings.proxy.header)
            if len(named) == 1 and named[0].strip():
                scope.setdefault("state", {})["user"] = named[0].strip()
                return None
        if settings.users:
            found = await self._known_user(headers.get("authorization", ""), "" if client is None else client[0])
            if isinstance(found, str):
                scope.setdefault("state", {})["user"] = found
                return None
            if found > 0.0:
                wait_s = ceil(found)
                text = f"There were too many wrong passwords. The next one is looked at in {wait_s} s."
                return PlainTextResponse(text, 429, {"retry-after": str(wait_s)})
        if not settings.users:
            return PlainTextResponse("The proxy has named no user.", 403)
        return PlainTextResponse(
            "A name and a password are needed.",
            401,
            {"www-authenticate": 'Basic realm="talc-gateway", charset="UTF-8"'},
        )

    def _is_method_of(self, scope: Scope) -> bool:
        commands = bool(self._settings.operators) and scope["path"].startswith("/command/")
        return scope["method"] in (("POST",) if commands else ("GET", "HEAD"))

    async def _known_user(self, authorization: str, address: str) -> str | float:
        """The name of the user, or for how long no password is looked at."""
        scheme, _, given = authorization.partition(" ")
        if scheme.lower() != "basic":
            return 0.0
        try:
            user, colon, password = b64decode(given.strip(), validate=True).decode().partition(":")
        except (NotBase64, UnicodeDecodeError, ValueError):
            return 0.0
        if not colon:
            return 0.0
        digest = hmac.digest(self._secret, f"{user}:{password}".encode(), hashlib.sha256)
        if digest in self._known:
            return user
        async with self._checks:
            if (wait_s := self._brake.wait_s(user, monotonic(), address)) > 0.0:
                return wait_s
            wanted = self._settings.users.get(user)
            right = wanted is not None and await asyncio.to_thread(matches, password, wanted)
            pause_s = self._brake.tried(user, monotonic(), right=right, address=address, checked=wanted is not None)
        if right:
            self._known[digest] = None
            if len(self._known) > _MOST_REMEMBERED:
                self._known.popitem(last=False)
            return user
        if pause_s:
            given_for = repr(user)[:64]
            log.warning("%s", Text(NoticeCode.PASSWORD_WRONG_AGAIN, user=given_for, address=address, pause_s=pause_s))
        return 0.0


def _host_name(host: str) -> str:
    """The name in a Host header, without its port."""
    if host.startswith("["):
        return host[1:].partition("]")[0].lower()
    return host.partition(":")[0].lower()
