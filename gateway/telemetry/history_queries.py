"""Answers queries on `history` in a thread of its own, one after the other: a page of stored readings, or what is wrong
with the query."""

import logging
import queue
import threading
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime

import zenoh

from gateway.telemetry import keys
from gateway.telemetry.messages import HistoryPage, QueryRefused, encode

log = logging.getLogger(__name__)

MOST_ROWS = 50_000
"""Of one page; a page has a fifth of it unless `limit` says otherwise."""
_ROWS, _MOST_DIGITS = MOST_ROWS // 5, 9
_MOST_WAITING = 8
_JSON = zenoh.Encoding.APPLICATION_JSON
_KNOWN = ("from", "to", "channels", "limit", "after")


@dataclass(frozen=True, slots=True)
class HistoryRequest:
    """What a query on `history` asks for."""

    begin: datetime
    end: datetime
    channels: tuple[str, ...] | None
    """None: all."""
    limit: int
    after: str | None
    """`next` of the page before; None: from the beginning."""


HistorySource = Callable[[HistoryRequest], HistoryPage]
"""Finds a page. Raises ValueError when the request is wrong, OSError when there is nothing to read from."""


def parse(selected: str) -> HistoryRequest:
    """The request of a selector's parameters, `name=value` separated by `;`.

    Raises ValueError naming parameter, value and what would be right.
    """
    parts = (part.partition("=") for part in selected.split(";") if part)
    parameters = {name: value for name, _, value in parts}
    for name in parameters:
        if name not in _KNOWN and not name.startswith("_"):  # Zenoh's own begin with _
            raise ValueError(f"{name}: unknown; known are {', '.join(_KNOWN)}")
    begin, end = _time(parameters, "from"), _time(parameters, "to")
    if end <= begin:
        raise ValueError(f"to = {parameters['to']!r}: expected later than from = {parameters['from']!r}")
    limit = parameters.get("limit", str(_ROWS))
    if not (limit.isascii() and limit.isdecimal() and len(limit) <= _MOST_DIGITS and 1 <= int(limit) <= MOST_ROWS):
        raise ValueError(f"limit = {limit!r}: expected 1 to {MOST_ROWS}")
    channels = tuple(name for name in parameters.get("channels", "").split(",") if name)
    return HistoryRequest(begin, end, channels or None, int(limit), parameters.get("after"))


def _time(parameters: dict[str, str], name: str) -> datetime:
    expected = "expected a time with its offset from UTC, such as 2026-03-02T06:00:00Z"
    if name not in parameters:
        raise ValueError(f"{name}: missing; {expected}")
    try:
        time = datetime.fromisoformat(parameters[name])
    except ValueError:
        time = None
    if time is None or time.tzinfo is None:
        raise ValueError(f"{name} = {parameters[name]!r}: {expected}")
    return time


class HistoryQueries:
    """Takes queries in Zenoh's threads and answers them in its own.

    Parameters
    ----------
    key: of the answers
    source: where they come from; None: every query is refused
    """

    def __init__(self, key: str, source: HistorySource | None) -> None:
        self._key, self._source = key, source
        self._waiting: queue.Queue[zenoh.Query | None] = queue.Queue(_MOST_WAITING)
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, name="history", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def close(self) -> None:
        """Answer no more; what waits is refused. Returns when the thread has ended."""
        self._closed.set()
        self._waiting.put(None)
        self._thread.join()

    def take(self, query: zenoh.Query) -> None:
        """Put a query into the queue; called by Zenoh. One that only matches by wildcards gets no reply."""
        if not keys.asks_for(keys.HISTORY, str(query.key_expr)):
            query.drop()
            return
        try:
            self._waiting.put_nowait(query)
        except queue.Full:
            with query:
                _refuse(query, f"busy: {_MOST_WAITING} queries wait already; ask again")

    def _run(self) -> None:
        while (query := self._waiting.get()) is not None:
            with query:
                if self._closed.is_set():
                    _refuse(query, "the gateway stops")
                else:
                    self._answer(query)

    def _answer(self, query: zenoh.Query) -> None:
        try:
            if self._source is None:
                raise OSError("this gateway has no store")
            page = self._source(parse(str(query.parameters)))
        except (ValueError, OSError) as error:
            _refuse(query, str(error))
        except Exception as error:
            log.exception("history: %s", query.selector)
            _refuse(query, f"unexpected {type(error).__name__}")
        else:
            query.reply(self._key, encode(page), encoding=_JSON)


def _refuse(query: zenoh.Query, why: str) -> None:
    query.reply_err(encode(QueryRefused(f"history: {why}")), encoding=_JSON)
