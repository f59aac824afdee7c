"""A reader's sessions: a client's to each place, opened again and again. A client hears a gateway that listens there
and, at a router, gateways of either mode; a peer would not hear the peers behind a router."""

import logging
import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial
from typing import Self

import zenoh

from drivers.base import SystemClock
from gateway.config.telemetry import Telemetry
from gateway.model.codes import NoticeCode
from gateway.model.connection import Connection
from gateway.model.text import Text
from gateway.runtime.problems import Problems
from gateway.telemetry.kept import Kept, KeptSession
from gateway.telemetry.session import own_access, page_config

log = logging.getLogger(__name__)

_PERIOD_S = 2.0
_OPENS_S = 2.0
"""How long the entry waits for the first attempts."""


class PlaceSessions:
    """Connects to all places at `connect` while it is entered, and logs which of them cannot be reached, and why.

    Parameters
    ----------
    telemetry: where to connect and how, and whether others are found by multicast too
    opened: called in a thread with each session once, when it has opened
    """

    def __init__(self, telemetry: Telemetry, opened: Callable[[zenoh.Session], None] = lambda _: None) -> None:
        self._lock = threading.Lock()
        self._problems = Problems(SystemClock(), _PERIOD_S, lambda _: None, log)
        self._kept = {
            place: KeptSession(
                Kept(
                    partial(page_config, telemetry, place),
                    partial(own_access, telemetry),
                    (place,) if place else (),
                ),
                partial(self._changed, place),
            )
            for place in dict.fromkeys((*telemetry.connect, *(("",) if telemetry.multicast else ())))
        }
        self._leaving, self._opened = ExitStack(), opened

    def __enter__(self) -> Self:
        for kept in self._kept.values():
            kept.start(self._opened)
            self._leaving.callback(kept.close)
        for kept in self._kept.values():
            kept.tried(_OPENS_S)
        return self

    def __exit__(self, *_: object) -> None:
        self._leaving.close()

    @property
    def open(self) -> Sequence[zenoh.Session]:
        """Those that have opened."""
        return [kept.session for kept in self._kept.values() if kept.session is not None]

    @property
    def problems(self) -> Sequence[Text]:
        """Why places are not connected, one each."""
        return [kept.connection.problem for kept in self._kept.values() if kept.connection.problem]

    def _changed(self, place: str, now: Connection) -> None:
        with self._lock:
            if now.problem:
                why = now.problem.value_of("why")
                self._problems.report(place, Text(NoticeCode.PLACE_AWAY, why=why), now.kind)
            else:
                self._problems.clear(place, NoticeCode.PLACE_BACK, place=place)
