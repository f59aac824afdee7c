"""What comes back of a gateway's own keys from the router that it connects to, in a session of its own: whether the
router lets through what it sends, and whether another gateway has its name."""

import time
from dataclasses import replace

import zenoh

from gateway.config.telemetry import Telemetry
from gateway.model.connection import Connection
from gateway.telemetry import keys
from gateway.telemetry.codec import decode
from gateway.telemetry.kept import Kept, KeptSession
from gateway.telemetry.session import own_access, reader_config

_EVERY_S = 10.0
_ANSWER_LIMIT_S = 2.0
_MOST_UNHEARD = 3
"""After so many questions without an answer it is said that none comes back."""


class Echo:
    """Asks at `connect` from `start` to `close` for the status of the gateways of this name; without `connect` nobody.

    Parameters
    ----------
    settings: the [telemetry] section
    root: with which the gateway's keys begin
    boot: this run of the gateway
    """

    def __init__(self, settings: Telemetry, root: str, boot: str) -> None:
        self._selector, self._boot = f"{root}/{keys.STATUS}", boot
        kept = Kept(lambda: reader_config(settings.connect, own_access(settings)), None, settings.connect)
        self._kept = KeptSession(kept, looked=self._ask) if settings.connect else None
        self._asked_s, self._unheard = -_EVERY_S, 0
        self._confirmed: bool | None = None
        self._other = ""

    def start(self) -> None:
        """Begin to ask."""
        if self._kept is not None:
            self._kept.start()

    def close(self) -> None:
        """Ask no more."""
        if self._kept is not None:
            self._kept.close()

    def known(self, connection: Connection) -> Connection:
        """The same with what has come back."""
        return replace(connection, confirmed=None if connection.problem else self._confirmed, other=self._other)

    def _ask(self, session: zenoh.Session) -> None:
        if time.monotonic() - self._asked_s < _EVERY_S:
            return
        self._asked_s = time.monotonic()
        every = zenoh.ConsolidationMode.NONE  # else of two gateways' answers one is passed on
        boots = set[str]()
        for reply in session.get(self._selector, timeout=_ANSWER_LIMIT_S, consolidation=every):
            if reply.ok is not None:
                boots.add(_boot_of(reply.ok.payload.to_bytes()))
        self._other = min(boots - {self._boot, ""}, default="")
        self._unheard = 0 if self._boot in boots else self._unheard + 1
        if not self._unheard:
            self._confirmed = True
        elif self._unheard >= _MOST_UNHEARD:
            self._confirmed = False


def _boot_of(payload: bytes) -> str:
    """Empty: it is no status."""
    try:
        message = decode(keys.STATUS, payload)
    except ValueError:
        return ""
    return "" if message is None else message.boot
