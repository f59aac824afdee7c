"""Answers queries on one key in a separate thread, one after the other, with the requested data or an error."""

import logging
import queue
import threading
from collections.abc import Callable
from typing import NamedTuple

import zenoh

from gateway.model.codes import NoticeCode
from gateway.model.text import Text, text_of
from gateway.telemetry import keys
from gateway.telemetry.answers import QueryRefused
from gateway.telemetry.codec import encode
from gateway.telemetry.fields import coded

log = logging.getLogger(__name__)

MOST_ROWS = 50_000
"""Most rows of one page; a page has a fifth of that unless `limit` says otherwise."""
_MOST_WAITING = 8
_MOST_DIGITS = 9
_JSON = zenoh.Encoding.APPLICATION_JSON


class AskedQuery(NamedTuple):
    """A query."""

    below: str
    """The part of its key after the kind; empty: nothing."""
    parameters: str
    payload: bytes
    attachment: bytes


class Replied(NamedTuple):
    """What it is answered with."""

    payload: bytes
    attachment: bytes | None = None


Answering = Callable[[AskedQuery], Replied]
"""Raises ValueError when what was asked is wrong, OSError when there is nothing to read from."""


class Queries:
    """Takes queries in Zenoh's threads and answers them in its own.

    Parameters
    ----------
    root: with which the gateway's keys begin
    kind: of the key, the part behind it
    answer: where answers come from; None: every query is refused
    below: whether there are keys below it, too
    """

    def __init__(self, root: str, kind: str, answer: Answering | None, *, below: bool = False) -> None:
        self.key, self._kind, self._source = f"{root}/{kind}", kind, answer
        self.declared = f"{self.key}/**" if below else self.key
        """Key expression to declare."""
        self._waiting: queue.Queue[zenoh.Query | None] = queue.Queue(_MOST_WAITING)
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, name=kind, daemon=True)

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
        if not keys.asks_for(self._kind, str(query.key_expr)) or not self._is_named_by(query):
            query.drop()
            return
        try:
            self._waiting.put_nowait(query)
        except queue.Full:
            with query:
                self._refuse(query, f"busy: {_MOST_WAITING} queries are waiting already; ask again")

    def _run(self) -> None:
        while (query := self._waiting.get()) is not None:
            with query:
                if self._closed.is_set():
                    self._refuse(query, "the gateway is stopping")
                else:
                    self._answer(query)

    def _answer(self, query: zenoh.Query) -> None:
        try:
            if self._source is None:
                raise OSError("this gateway has no store")
            asked = self._asked(query)
            replied = self._source(asked)
        except (ValueError, OSError) as error:
            self._refuse(query, text_of(error))
        except Exception as error:
            log.exception("unexpected error while answering %s; please report this", query.selector)
            self._refuse(
                query, f"unexpected {type(error).__name__}; please report it with the traceback in the gateway's log"
            )
        else:
            key = f"{self.key}/{asked.below}" if asked.below else self.key
            query.reply(key, replied.payload, encoding=_JSON, attachment=replied.attachment)

    def _is_named_by(self, query: zenoh.Query) -> bool:
        """Whether a reply can have a key that the query is for."""
        key = str(query.key_expr)
        return key.startswith(f"{self.key}/") or query.key_expr.intersects(zenoh.KeyExpr(self.key))

    def _asked(self, query: zenoh.Query) -> AskedQuery:
        payload, attachment = query.payload, query.attachment
        return AskedQuery(
            key[len(self.key) + 1 :] if (key := str(query.key_expr)).startswith(f"{self.key}/") else "",
            str(query.parameters),
            b"" if payload is None else payload.to_bytes(),
            b"" if attachment is None else attachment.to_bytes(),
        )

    def _refuse(self, query: zenoh.Query, why: str) -> None:
        """Always with a code: only earlier programs have none."""
        of = why if isinstance(why, Text) and why.code else Text(NoticeCode.QUERY_REFUSED, kind=self._kind, why=why)
        query.reply_err(encode(QueryRefused(f"{self._kind}: {why}", coded(of))), encoding=_JSON)


def parameters_of(selected: str, known: tuple[str, ...]) -> dict[str, str]:
    """The parameters of a selector, `name=value` separated by `;`. Raises ValueError naming one that is not known."""
    parts = (part.partition("=") for part in selected.split(";") if part)
    parameters = {name: value for name, _, value in parts}
    for name in parameters:
        if name not in known and not name.startswith("_"):  # Zenoh's own begin with _
            raise ValueError(Text(NoticeCode.PARAMETER_UNKNOWN, name=name, known=known))
    return parameters


def limit_of(parameters: dict[str, str], usual: int, most: int) -> int:
    """The parameter `limit`. Raises ValueError naming it and what would be right."""
    limit = parameters.get("limit", str(usual))
    if not (limit.isascii() and limit.isdecimal() and len(limit) <= _MOST_DIGITS and 1 <= int(limit) <= most):
        raise ValueError(f"limit = {limit!r}: expected 1 to {most}")
    return int(limit)
