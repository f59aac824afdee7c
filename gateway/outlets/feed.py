"""The messages that wait for one outlet: a bounded queue with its policy, however long the outlet is away."""

import logging
import threading
from collections import deque
from collections.abc import Callable
from time import monotonic

from gateway.heard import instant
from gateway.outlets.outlet import Outlet, OutletError, OutletMessage, OutletSettings, Unacceptable
from gateway.polling import Breaker
from gateway.telemetry import ReadingMessage, keys

log = logging.getLogger(__name__)

_SHORTEST_PAUSE_S, _LONGEST_PAUSE_S = 1.0, 60.0


class Feed:
    """The messages on their way to one outlet. `put` is called from any thread and never waits for the outlet.

    Parameters
    ----------
    settings: of the outlet
    outlet: made from them
    """

    def __init__(self, settings: OutletSettings, outlet: Outlet) -> None:
        self._settings, self._outlet = settings, outlet
        self._wanted = settings.possible if settings.kinds is None else settings.possible & set(settings.kinds)
        self._news = threading.Condition()
        self._waiting: deque[OutletMessage] = deque()
        self._first_s = 0.0
        """When the oldest of those that wait came to the front, monotonic."""
        self._passed: dict[tuple[str, str], ReadingMessage] = {}
        self._stopping = False
        self._open, self._problem = False, ""
        self._breaker = Breaker(_SHORTEST_PAUSE_S, _LONGEST_PAUSE_S)
        self._gone_s, self._refusal, self._dropped_before = 0.0, "", 0
        self.sent = 0
        self.dropped = 0
        """Because too many were waiting."""
        self.unacceptable = 0
        """Because the other side would not take them."""

    @property
    def name(self) -> str:
        """The outlet's name."""
        return self._settings.name

    @property
    def account(self) -> str:
        """What became of the messages, in words."""
        return (
            f"{self.sent} messages sent, {self.dropped} dropped because too many waited, {self.unacceptable} not"
            f" accepted, {self.waiting} waiting"
        )

    @property
    def problem(self) -> str:
        """Why the outlet is away; empty while it is not."""
        return self._problem

    @property
    def waiting(self) -> int:
        """How many messages wait."""
        return len(self._waiting)

    def put(self, heard: OutletMessage, now_s: float) -> None:
        """Take in what was heard; the oldest goes when there are too many."""
        if heard.message is not None and keys.kind_of(heard.suffix) not in self._wanted:
            return
        with self._news:
            if not self._due(heard):
                return
            if not self._waiting:
                self._first_s = now_s
            self._waiting.append(heard)
            self._bound()
            self._news.notify()

    def _due(self, heard: OutletMessage) -> bool:
        """Whether a reading comes long enough after the one that was passed on, by the gateway's own times."""
        message, every_s = heard.message, self._settings.reading_every_s
        if not every_s or not isinstance(message, ReadingMessage):
            return True
        last = self._passed.get((heard.machine, heard.suffix))
        if last is not None and (last.quality, last.boot) == (message.quality, message.boot):
            now, before = instant(message.time), instant(last.time)
            if now is not None and before is not None and 0.0 <= (now - before).total_seconds() < every_s:
                return False
        self._passed[heard.machine, heard.suffix] = message
        return True

    def _bound(self) -> None:
        while len(self._waiting) > self._settings.most_waiting:
            self._waiting.popleft()
            self.dropped += 1

    def run(self, clock: Callable[[], float] = monotonic) -> None:
        """Send until `stop`. Runs in its own thread."""
        while not self._ended():
            self.turn(clock())
            with self._news:
                left_s = self._due_s(now_s := clock()) - now_s
                if left_s > 0.0 and not self._ended():
                    self._news.wait(min(left_s, _LONGEST_PAUSE_S))
        self._close()

    def stop(self) -> None:
        """End `run`; what waits is lost."""
        with self._news:
            self._stopping = True
            self._news.notify()

    def _ended(self) -> bool:
        return self._stopping

    def turn(self, now_s: float) -> float:
        """Send one batch, if it is time. Returns when the next turn is due, monotonic."""
        due_s = self._due_s(now_s)
        if due_s > now_s and (self._open or self._breaker.failing):
            return due_s
        batch: list[OutletMessage] = []
        try:
            if not self._open:
                self._outlet.open()
                self._open = True
            with self._news:
                batch = [self._waiting.popleft() for _ in range(min(len(self._waiting), self._settings.batch))]
                self._first_s = now_s
            if batch:
                self._outlet.send(batch)
            self.sent += len(batch)
        except Unacceptable as error:
            self.unacceptable += len(batch)
            if str(error) != self._refusal:
                log.warning("%s: %d messages are not accepted and were dropped: %s", self._settings.name, len(batch),
                            error)  # fmt: skip
            self._refusal = str(error)
        except OutletError as error:
            return self._gone(batch, error, now_s)
        except (Exception, SystemExit) as error:  # the outlet's fault, not the end of its feed
            if (unexpected := f"unexpected {type(error).__name__}: {error}") != self._problem:
                log.exception("%s: please report this", self._settings.name)
            return self._gone(batch, OutletError(unexpected), now_s)
        self._back(now_s)
        return self._due_s(now_s)

    def _due_s(self, now_s: float) -> float:
        """When the next turn has something to do, monotonic."""
        if self._breaker.failing:
            return self._breaker.retry_at
        with self._news:
            if not self._waiting:
                return now_s + _LONGEST_PAUSE_S
            full = len(self._waiting) >= self._settings.batch
            return now_s if full else self._first_s + self._settings.gather_s

    def _close(self) -> None:
        """Let go of the connection, whatever the library raises at that."""
        try:
            self._outlet.close()
        except (Exception, SystemExit) as error:  # a new one is made at the next opening
            log.debug("%s: closing raised %r", self._settings.name, error, exc_info=True)
        self._open = False

    def _gone(self, batch: list[OutletMessage], error: OutletError, now_s: float) -> float:
        self._close()
        with self._news:
            self._waiting.extendleft(reversed(batch))
            self._bound()
        if not self._breaker.failing:
            self._gone_s, self._dropped_before = now_s, self.dropped
            log.warning(
                "%s: %s; messages wait, at most %d", self._settings.name, str(error), self._settings.most_waiting
            )
        self._problem = str(error)
        self._breaker.failed(now_s)
        return self._breaker.retry_at

    def _back(self, now_s: float) -> None:
        if self._breaker.failing:
            lost = self.dropped - self._dropped_before
            log.warning("%s: is back after %.0f s; %d messages were dropped meanwhile", self._settings.name,
                        now_s - self._gone_s, lost)  # fmt: skip
        self._problem = ""
        self._breaker.succeeded()
