"""Messages that cannot be read: reported when that begins and when it ends, whoever publishes them and how often."""

import logging
import threading

from drivers.base import Clock, SystemClock
from gateway.model.codes import NoticeCode
from gateway.model.text import Text
from gateway.runtime.problems import Problems

_PERIOD_S = 1.0
_MOST_SUBJECTS = 1000
"""Any program on the network can publish under new names without end."""


class UnreadableMessages:
    """What could not be read, by machine and key. May be called from several threads.

    Parameters
    ----------
    log: where it is reported
    consequence: what is said of such messages
    clock: its monotonic seconds are used
    """

    def __init__(self, log: logging.Logger, consequence: str, clock: Clock | None = None) -> None:
        self._consequence, self._lock = consequence, threading.Lock()
        self._problems = Problems(clock or SystemClock(), _PERIOD_S, lambda _: None, log)
        self._seen = set[str]()
        """Subjects of which a message could not be read at least once."""

    def invalid(self, machine: str, suffix: str, error: ValueError) -> None:
        """A message could not be read."""
        subject = f"{machine}: {suffix}"
        with self._lock:
            if subject in self._seen or len(self._seen) < _MOST_SUBJECTS:
                self._seen.add(subject)
                text = Text(NoticeCode.UNREADABLE, machine=machine, consequence=self._consequence, error=str(error))
                self._problems.report(subject, text)
            else:
                self._problems.report("all", Text(NoticeCode.MANY_UNREADABLE, n=_MOST_SUBJECTS))

    def valid(self, machine: str, suffix: str) -> None:
        """A message was read."""
        subject = f"{machine}: {suffix}"
        if subject in self._seen:
            with self._lock:
                self._problems.clear(subject, NoticeCode.READABLE_AGAIN, subject=subject)
