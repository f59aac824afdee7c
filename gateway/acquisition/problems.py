"""Which problems to report: each once when it begins and once when it ends, unless it is intermittent."""

from collections import deque
from dataclasses import dataclass, field
from enum import Enum


class Word(Enum):
    """What to say of a problem that is met."""

    NOTHING = 0
    TELL = 1
    LAST = 2
    """Tell, and that it comes and goes: nothing more is told of it until it has been steady."""


@dataclass(slots=True)
class _History:
    failing: bool = False
    muted: bool = False
    changed_s: float = 0.0
    kinds: set[str] = field(default_factory=set)
    """What was told since it began."""
    begun_s: deque[float] = field(default_factory=deque)


class Steadiness:
    """Remembers each subject's problems. Times are monotonic seconds.

    Parameters
    ----------
    window_s: how long a subject must stay as it is to count as steady, s, > 0
    most: beginnings within that time that are told; with the next one it comes and goes
    """

    def __init__(self, window_s: float, most: int = 3) -> None:
        self._window_s, self._most = window_s, most
        self._subjects: dict[str, _History] = {}

    @property
    def window_s(self) -> float:
        return self._window_s

    def bad(self, subject: str, kind: str, now_s: float) -> Word:
        """The subject has a problem of this kind. Call it whenever that is seen."""
        history = self._subjects.setdefault(subject, _History())
        if history.failing:
            history.muted &= now_s - history.changed_s < self._window_s
            if history.muted or kind in history.kinds:
                return Word.NOTHING
            history.kinds.add(kind)
            return Word.TELL
        history.failing, history.changed_s = True, now_s
        if history.muted:
            return Word.NOTHING
        history.kinds = {kind}
        history.begun_s.append(now_s)
        while history.begun_s[0] <= now_s - self._window_s:
            history.begun_s.popleft()
        history.muted = len(history.begun_s) > self._most
        return Word.LAST if history.muted else Word.TELL

    def well(self, subject: str, now_s: float) -> bool:
        """The subject has no problem. Call it whenever that is seen. True: tell that its problem has ended."""
        history = self._subjects.get(subject)
        if history is None:
            return False
        if history.failing:
            history.failing, history.changed_s = False, now_s
            return not history.muted
        if now_s - history.changed_s < self._window_s:
            return False
        del self._subjects[subject]
        return history.muted
