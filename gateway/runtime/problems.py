"""Reports problems: each once when it begins and once when it ends, unless it is intermittent."""

import logging
import traceback
from collections import deque
from dataclasses import dataclass, field
from typing import Protocol

from gateway.model.codes import NoticeCode
from gateway.model.notice import Notice, Notify
from gateway.model.text import Text, Value

_STEADY_S = 60.0
"""A problem unchanged for this long is steady; one that begins often within it is intermittent."""
_STEADY_PERIODS = 10
"""Or for this many periods, if that is longer."""
_MOST_KINDS = 10
"""Of one problem, from its beginning to its end: the reason may be a text that is different each time."""


class Monotonic(Protocol):
    """A clock, as far as problems need one."""

    def monotonic(self) -> float:
        """Seconds that never jump."""
        ...


@dataclass(slots=True)
class TurnTime:
    """The time of what is given its time at each turn, as a clock: it stands still within a turn."""

    now_s: float = 0.0
    """To be set as a turn begins, monotonic."""

    def monotonic(self) -> float:
        """See Monotonic."""
        return self.now_s


@dataclass(slots=True)
class _SubjectHistory:
    failing: bool = False
    muted: bool = False
    changed_s: float = 0.0
    kinds: set[str] = field(default_factory=set)
    """What has been reported since it began."""
    begun_s: deque[float] = field(default_factory=deque)


class Problems:
    """Remembers each subject's problems; reports and logs what is new.

    A subject with more than `most` new problems before it has been steady is intermittent: that is reported with the
    last beginning, and then nothing until it has been steady. Steady means unchanged for a minute and for ten periods.
    Of a problem that changes its kind again and again, ten kinds are reported until it ends.

    Parameters
    ----------
    clock: a service's own, or a TurnTime
    period_s: how often the subjects are checked, s, > 0
    notify: receives each problem as it begins and as it ends
    log: where both are logged too, at the same level: a log that shows faults shows that they ended
    most: beginnings that are reported before a subject is steady
    quiet: log only the first of each unexpected problem, with its traceback, because `notify` shows all
    """

    def __init__(
        self,
        clock: Monotonic,
        period_s: float,
        notify: Notify,
        log: logging.Logger,
        *,
        most: int = 3,
        quiet: bool = False,
    ) -> None:
        self._clock, self._notify, self._log, self._most, self._quiet = clock, notify, log, most, quiet
        self._window_s = max(_STEADY_S, _STEADY_PERIODS * period_s)
        self._subjects: dict[str, _SubjectHistory] = {}
        self._told: set[str] = set()
        """The facts."""
        self._traced: set[tuple[str, str, int]] = set()
        """Where the unexpected exceptions arose whose traceback is in the log."""

    @property
    def window_s(self) -> float:
        """How long a subject must be unchanged to be steady, s."""
        return self._window_s

    def report(self, subject: str, text: Text, kind: str = "", *, bug: BaseException | None = None) -> None:
        """The subject has a problem. Call it whenever that is seen: it is reported when it begins or changes its kind.

        kind: identifies the same problem; by default the code of the text does
        bug: an unexpected exception; it is logged, the first time with its traceback
        """
        kind = kind or text.code
        now_s = self._clock.monotonic()
        history = self._subjects.setdefault(subject, _SubjectHistory())
        if history.failing:
            history.muted &= now_s - history.changed_s < self._window_s
            if history.muted or kind in history.kinds:
                return
            if len(history.kinds) >= _MOST_KINDS:
                if (other := self._first_of(bug)) is not None:
                    self._log.warning("%s", text, exc_info=other)
                return
            history.kinds.add(kind)
            if len(history.kinds) == _MOST_KINDS:
                text = Text(NoticeCode.NO_MORE_KINDS, problem=text)
        else:
            history.failing, history.changed_s = True, now_s
            if history.muted:
                return
            history.kinds = {kind}
            history.begun_s.append(now_s)
            while history.begun_s[0] <= now_s - self._window_s:
                history.begun_s.popleft()
            history.muted = len(history.begun_s) > self._most
            if history.muted:
                text = Text(NoticeCode.INTERMITTENT, problem=text, window_s=self._window_s)
        first = self._first_of(bug)
        if first is not None or not self._quiet:
            self._log.warning("%s", text, exc_info=first)
        self._notify(Notice(subject, text, at_s=now_s))

    def tell(self, subject: str, text: Text) -> None:
        """This is so, and no problem. Call it whenever that is seen: it is reported once."""
        if text in self._told:
            return
        self._told.add(text)
        if not self._quiet:
            self._log.info("%s", text)
        self._notify(Notice(subject, text, is_fact=True, at_s=self._clock.monotonic()))

    def _first_of(self, bug: BaseException | None) -> BaseException | None:
        """The same, unless one of its kind and place has been logged."""
        if bug is None:
            return None
        frames = traceback.extract_tb(bug.__traceback__)
        file, line = (frames[-1].filename, frames[-1].lineno or 0) if frames else ("", 0)
        place = (type(bug).__name__, file, line)
        if place in self._traced:
            return None
        self._traced.add(place)
        return bug

    def clear(self, subject: str, code: NoticeCode, /, **values: Value) -> None:
        """The subject has no problem. Call it whenever that is seen: the end of a reported problem is reported.

        code, values: what is said then; nothing is written of an end that is not reported
        """
        history = self._subjects.get(subject)
        if history is None:
            return
        now_s = self._clock.monotonic()
        if history.failing:
            history.failing, history.changed_s = False, now_s
            ended = not history.muted
        elif now_s - history.changed_s < self._window_s:
            return
        else:
            del self._subjects[subject]
            ended = history.muted
        if ended:
            text = Text(code, **values)
            if not self._quiet:
                self._log.warning("%s", text)
            self._notify(Notice(subject, text, ended=True, at_s=now_s))
