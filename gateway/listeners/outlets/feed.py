"""The messages that wait for one outlet: a bounded queue with its policy, however long the outlet is away."""

import logging
import math
import threading
from collections import deque
from collections.abc import Callable
from time import monotonic

from gateway.listeners.outlets.outlet import Outlet, OutletError, OutletMessage, OutletSettings, Unacceptable
from gateway.model.codes import NoticeCode
from gateway.model.notice import Notice
from gateway.model.text import Text, text_of
from gateway.runtime.breaker import Breaker
from gateway.runtime.problems import Problems, TurnTime
from gateway.telemetry import keys
from gateway.telemetry.messages import ReadingMessage
from gateway.telemetry.subscriber.instants import instant

log = logging.getLogger(__name__)

_SHORTEST_PAUSE_S = 1.0
_LONGEST_PAUSE_S = 60.0


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
        self._time = TurnTime()
        self._problems = Problems(self._time, _LONGEST_PAUSE_S, self._noticed, log)
        self._began: dict[str, int] = {}
        """By subject of a problem that was reported: how many messages were lost until it began."""
        self._refused_s = -math.inf
        self._gone_s = self._away_s = 0.0
        """When it was away the last time, monotonic, and how long."""
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
        self._time.now_s = now_s
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
                self._accepted(len(batch))
        except Unacceptable as error:
            self._refused(len(batch), error)
        except OutletError as error:
            return self._gone(batch, text_of(error), now_s)
        except (Exception, SystemExit) as error:  # noqa: BLE001 - an outlet's fault must not end its feed; it is reported
            return self._gone(batch, f"unexpected {type(error).__name__}: {error}", now_s, bug=error)
        self._back(now_s)
        return self._due_s(now_s)

    def _noticed(self, notice: Notice) -> None:
        if notice.ended:
            self._began.pop(notice.subject, None)
        elif notice.subject not in self._began:
            self._began[notice.subject] = self.dropped if notice.subject == self.name else self.unacceptable

    def _accepted(self, messages: int) -> None:
        self.sent += messages
        if self._time.now_s - self._refused_s < self._problems.window_s:
            return  # other messages may be refused again and again, between those that are accepted
        lost = self.unacceptable - self._began.get(self._acceptance, self.unacceptable)
        self._problems.clear(self._acceptance, NoticeCode.OUTLET_ACCEPTS, outlet=self.name, lost=lost)

    def _refused(self, messages: int, error: Unacceptable) -> None:
        text = Text(NoticeCode.OUTLET_NOT_ACCEPTED, outlet=self.name, n=messages, error=text_of(error))
        self._problems.report(self._acceptance, text, str(error))
        self._refused_s = self._time.now_s
        self.unacceptable += messages

    @property
    def _acceptance(self) -> str:
        """Subject: the outlet is there, but may not take what it is given."""
        return f"messages of {self.name}"

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

    def _gone(self, batch: list[OutletMessage], why: str, now_s: float, bug: BaseException | None = None) -> float:
        self._close()
        kind = "away" if bug is None else type(bug).__name__
        code = NoticeCode.OUTLET_AWAY if bug is None else NoticeCode.OUTLET_FAILED
        text = Text(code, outlet=self.name, why=why, most=self._settings.most_waiting)
        self._problems.report(self.name, text, kind, bug=bug)
        if not self._breaker.failing:
            self._gone_s = now_s
        with self._news:
            self._waiting.extendleft(reversed(batch))
            self._bound()
        self._problem = why
        self._breaker.failed(now_s)
        return self._breaker.retry_at

    def _back(self, now_s: float) -> None:
        if self._breaker.failing:
            self._away_s = now_s - self._gone_s
        self._problem = ""
        self._breaker.succeeded()
        lost = self.dropped - self._began.get(self.name, self.dropped)
        self._problems.clear(self.name, NoticeCode.OUTLET_BACK, outlet=self.name, away_s=self._away_s, lost=lost)
