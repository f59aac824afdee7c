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


class Work(NamedTuple):
    """What makes an answer, and takes its time."""

    answer: Callable[[], Replied]
    """Raises as `Answering`."""
    urgent: bool
    """Whether it has its own lane, in which it waits for no other work and is never refused because many wait."""


Sifting = Callable[[AskedQuery], Replied | Work]
"""Answers at once, or says what there is to do; quick. Raises as `Answering`."""


_Waiting = tuple[zenoh.Query, AskedQuery, Work]


class Queries:
    """Takes queries in Zenoh's threads and answers them in its own.

    Parameters
    ----------
    root: with which the gateway's keys begin
    kind: of the key, the part behind it
    answer: where answers come from; None: every query is refused
    sift: looks at each query in Zenoh's thread first, so that only what it lets pass can fill the queue
    """

    def __init__(self, root: str, kind: str, answer: Answering | None = None, *, sift: Sifting | None = None) -> None:
        self.key, self._kind, self._source = f"{root}/{kind}", kind, answer
        self._sift, below = sift, sift is not None
        self.declared = f"{self.key}/**" if below else self.key
        """Key expression to declare."""
        self._waiting: queue.Queue[_Waiting | None] = queue.Queue(_MOST_WAITING)
        self._urgent: queue.Queue[_Waiting | None] = queue.Queue()
        self._closed = threading.Event()
        lanes = (self._waiting,) if sift is None else (self._waiting, self._urgent)
        self._threads = [threading.Thread(target=self._run, args=(lane,), name=kind, daemon=True) for lane in lanes]

    def start(self) -> None:
        """Start to answer."""
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """Answer no more; what waits is refused. Returns when the thread has ended."""
        self._closed.set()
        self._waiting.put(None)
        self._urgent.put(None)
        for thread in self._threads:
            thread.join()

    def take(self, query: zenoh.Query) -> None:
        """Put a query into the queue; called by Zenoh. One that only matches by wildcards gets no reply."""
        if not keys.asks_for(self._kind, str(query.key_expr)) or not self._is_named_by(query):
            query.drop()
            return
        asked = self._asked(query)
        slow = Work(lambda: self._found(asked), urgent=False)
        work = slow if self._sift is None else self._sifted(query, asked, self._sift)
        if work is None:
            return
        try:
            (self._urgent if work.urgent else self._waiting).put_nowait((query, asked, work))
        except queue.Full:
            with query:
                self._refuse(query, f"busy: {_MOST_WAITING} queries are waiting already; ask again")

    def _sifted(self, query: zenoh.Query, asked: AskedQuery, sift: Sifting) -> Work | None:
        """None: it is answered."""
        found: Work | None = None

        def at_once() -> Replied | None:
            nonlocal found
            result = sift(asked)
            if isinstance(result, Work):
                found = result
                return None
            return result

        if self._reply(query, asked, at_once):
            query.drop()
        return found

    def _found(self, asked: AskedQuery) -> Replied:
        if self._source is None:
            raise OSError("this gateway has no store")
        return self._source(asked)

    def _run(self, lane: "queue.Queue[_Waiting | None]") -> None:
        while (waiting := lane.get()) is not None:
            query, asked, work = waiting
            with query:
                if self._closed.is_set():
                    self._refuse(query, "the gateway is stopping")
                else:
                    self._reply(query, asked, work.answer)

    def _reply(self, query: zenoh.Query, asked: AskedQuery, answer: Callable[[], Replied | None]) -> bool:
        """Whether there was an answer, or a refusal."""
        try:
            replied = answer()
        except (ValueError, OSError) as error:
            self._refuse(query, text_of(error))
        except Exception as error:
            log.exception("unexpected error while answering %s; please report this", query.selector)
            self._refuse(
                query, f"unexpected {type(error).__name__}; please report it with the traceback in the gateway's log"
            )
        else:
            if replied is None:
                return False
            key = f"{self.key}/{asked.below}" if asked.below else self.key
            query.reply(key, replied.payload, encoding=_JSON, attachment=replied.attachment)
        return True

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
