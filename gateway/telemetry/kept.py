"""A Zenoh session that is opened in its own thread, again and again until it opens, and looked at from then on."""

import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime

import zenoh

from drivers.error_words import in_words
from gateway.config.telemetry import EndpointParts
from gateway.model.codes import NoticeCode
from gateway.model.connection import Connection
from gateway.model.text import Text, plain
from gateway.telemetry.reaching import why_not
from gateway.telemetry.session import Access, without_path

log = logging.getLogger(__name__)

_AGAIN_S = 2.0
"""Between two attempts, and two looks; with the longest attempt and its explanation less than 10 s."""


@dataclass(frozen=True, slots=True)
class Kept:
    """Which session is kept."""

    config: Callable[[], zenoh.Config]
    """Makes the configuration anew for each attempt, as files may have been mended. Raises OSError."""
    access: Callable[[], Access] | None
    """What it proves itself with, to find out why it is not connected. Raises OSError. None: nobody asks why."""
    connect: tuple[str, ...]
    """Endpoints that it connects to."""
    listening: tuple[EndpointParts, ...] = ()
    """And those on which it waits for others."""


class KeptSession:
    """Opens the session and keeps it; everything happens in one thread, which `start` begins and `close` ends.

    Zenoh itself connects an open session again when the other side was away.

    Parameters
    ----------
    kept: which session
    changed: called in the thread when the connection is another one
    looked: called in the thread, every few seconds while it is connected; may block for a moment
    """

    def __init__(
        self,
        kept: Kept,
        changed: Callable[[Connection], None] = lambda _: None,
        looked: Callable[[zenoh.Session], None] = lambda _: None,
    ) -> None:
        self._kept, self._changed, self._look_on = kept, changed, looked
        self._closed, self._tried = threading.Event(), threading.Event()
        self._thread: threading.Thread | None = None
        self.session: zenoh.Session | None = None
        """None: it has not opened yet."""
        self.connection = Connection(datetime.now(UTC))
        """As it was found last; before the first attempt has ended as if it were open."""

    def start(self, opened: Callable[[zenoh.Session], None] = lambda _: None) -> None:
        """Begin to open it.

        opened: called once, in the thread, with the session that has opened; may block
        """
        # The threads of Zenoh's callbacks are as the one that begins them. One that is a daemon aborts the process when
        # it wakes while the interpreter ends: Python then ends the thread, which Rust does not allow.
        self._thread = threading.Thread(target=self._run, args=(opened,), name="telemetry session", daemon=False)
        self._thread.start()

    def tried(self, limit_s: float) -> None:
        """Wait until the first attempt has ended, or for so long."""
        self._tried.wait(limit_s)

    def stop(self) -> None:
        """Neither open nor look any more; an attempt that is under way ends first, after seconds."""
        self._closed.set()
        if self._thread is not None:
            self._thread.join()

    def close(self) -> None:
        """Stop, and close the session."""
        self.stop()
        if self.session is not None:
            self.session.close()

    def _run(self, opened: Callable[[zenoh.Session], None]) -> None:
        while not self._closed.is_set():
            if not threading.main_thread().is_alive():  # the program ends, and nobody has closed this
                if self.session is not None:
                    self.session.close()
                return
            try:
                self._found(self._opened_anew(opened) if self.session is None else self._looked(self.session))
            except Exception:  # it is tried again; without this thread nothing would be published
                log.exception("unexpected error in the telemetry's session; please report this")
            self._tried.set()
            self._closed.wait(_AGAIN_S)

    def _opened_anew(self, opened: Callable[[zenoh.Session], None]) -> Connection:
        places = ", ".join((*(place.text for place in self._kept.listening), *self._kept.connect))
        try:
            session = zenoh.open(self._kept.config())
        except OSError as error:
            return _away(_unread(error), places)
        except zenoh.ZError as error:
            if self._kept.listening:  # it does not wait for those that it connects to
                return _away(without_path(error), places, NoticeCode.TELEMETRY_NOT_OPEN)
            return self._unreached(without_path(error))
        self.session = session
        if not self._closed.is_set():
            opened(session)
        return self._looked(session)

    def _looked(self, session: zenoh.Session) -> Connection:
        if not self._kept.connect:
            return Connection(datetime.now(UTC))
        own = {str(place.port) for place in self._kept.listening}
        reached = sorted(
            {str(link.dst) for link in session.info.links() if str(link.src).rpartition(":")[2] not in own}
        )
        if reached:
            self._look_on(session)
            return Connection(datetime.now(UTC), ", ".join(reached))
        return self._unreached("")

    def _unreached(self, said: str) -> Connection:
        access = self._kept.access
        try:
            why = plain(said) if access is None else why_not(self._kept.connect, access(), said)
        except OSError as error:
            why = _unread(error)
        return _away(why, ", ".join(self._kept.connect))

    def _found(self, now: Connection) -> None:
        before = self.connection
        if (before.to, before.kind) == (now.to, now.kind):
            return
        if before.problem and now.problem:  # for another reason
            now = replace(now, since=before.since)
        self.connection = now
        self._changed(now)


def _away(why: str, places: str, code: NoticeCode = NoticeCode.TELEMETRY_AWAY) -> Connection:
    return Connection(datetime.now(UTC), problem=Text(code, places=places, why=why))


def _unread(error: OSError) -> Text:
    return Text(NoticeCode.TLS_FILE, path=str(error.filename), error=in_words(error))
