"""The messages that wait to be published: bounded by a stated policy, the oldest dropped first."""

import threading
from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

_MOST_AT_ONCE = 200


class Outgoing(NamedTuple):
    """One message."""

    number: int
    suffix: str
    payload: bytes


class Backlog:
    """A queue of two kinds of messages, in the order in which they came. Any thread may use it.

    When there are too many messages that may be lost, the oldest of them is dropped. Those that must arrive stay
    longer; beyond their bounds the oldest is dropped too: the store has them all, and a gap in `seq` shows it.

    Messages that may be lost leave together: to send one alone costs four times as much as to send it among fifty.

    Parameters
    ----------
    most_loose: messages that may be lost
    most_firm, most_firm_bytes: messages that must arrive, and their size
    gather_s: how long a message that may be lost waits for others, unless one that must arrive follows it, real seconds
    """

    def __init__(self, most_loose: int, most_firm: int, most_firm_bytes: int, gather_s: float) -> None:
        self._gather_s = gather_s
        self._changed = threading.Condition()
        self._loose, self._firm = deque[Outgoing](), deque[Outgoing]()
        self._most_loose, self._most_firm, self._most_firm_bytes = most_loose, most_firm, most_firm_bytes
        self._firm_bytes = self._number = 0
        self._closed = False
        self.dropped_loose = self.dropped_firm = 0

    def put(self, messages: Iterable[tuple[str, bytes]], *, firm: bool) -> None:
        """Add the newest messages: suffix and payload. firm: they must arrive."""
        with self._changed:
            before = len(self._loose)
            for suffix, payload in messages:
                self._number += 1
                waiting = Outgoing(self._number, suffix, payload)
                if firm:
                    self._put_firm(waiting)
                else:
                    self._loose.append(waiting)
            while len(self._loose) > self._most_loose:
                self._loose.popleft()
                self.dropped_loose += 1
            if firm or not before or before < _MOST_AT_ONCE <= len(self._loose):  # in between `take` gathers
                self._changed.notify()

    def _put_firm(self, waiting: Outgoing) -> None:
        self._firm.append(waiting)
        self._firm_bytes += len(waiting.payload)
        while len(self._firm) > self._most_firm or self._firm_bytes > self._most_firm_bytes:
            self._firm_bytes -= len(self._firm.popleft().payload)
            self.dropped_firm += 1

    @property
    def waiting(self) -> int:
        """How many messages wait."""
        return len(self._loose) + len(self._firm)

    def take(self) -> list[tuple[str, bytes]]:
        """The oldest, in order; waits for one, and then for those that follow it soon. Empty: it was closed and is."""
        with self._changed:
            self._changed.wait_for(lambda: self._loose or self._firm or self._closed)
            self._changed.wait_for(
                lambda: self._firm or self._closed or len(self._loose) >= _MOST_AT_ONCE, self._gather_s
            )
            return [self._oldest() for _ in range(min(_MOST_AT_ONCE, len(self._loose) + len(self._firm)))]

    def _oldest(self) -> tuple[str, bytes]:
        if self._firm and not (self._loose and self._loose[0].number < self._firm[0].number):
            first = self._firm.popleft()
            self._firm_bytes -= len(first.payload)
        else:
            first = self._loose.popleft()
        return first.suffix, first.payload

    def close(self) -> None:
        """`take` ends when nothing is left."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
