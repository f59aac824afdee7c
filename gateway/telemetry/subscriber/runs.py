"""Which run of each gateway a reader follows: two gateways of one name are kept apart, and it is said that there are
two."""

import logging
import math
import threading
from collections import deque
from dataclasses import dataclass, field

from gateway.model.codes import NoticeCode
from gateway.model.text import Text
from gateway.runtime.problems import Problems, TurnTime

_BESIDE_S = 60.0
"""A running gateway reports its state every 10 s: a run that is not heard for so long has ended."""
_MOST_FORMER = 50


@dataclass(slots=True)
class _OneName:
    """The runs that were heard under one name."""

    boot: str = ""
    """The run that is followed."""
    heard_s: float = -math.inf
    former: deque[str] = field(default_factory=lambda: deque(maxlen=_MOST_FORMER))
    """Runs that another one has followed."""
    other_s: float = -math.inf
    """When one of them was heard again: it has not ended."""

    def follows(self, boot: str, now_s: float) -> bool:
        if boot != self.boot:
            if boot in self.former:
                self.other_s = now_s
                if now_s - self.heard_s <= _BESIDE_S:
                    return False
            if self.boot:
                self.former.append(self.boot)
            self.boot = boot
        self.heard_s = now_s
        return True


class HeardRuns:
    """Follows one run of each name: the latest that was begun to be heard, as long as it is heard. Any thread may use
    it.

    Parameters
    ----------
    log: where it is said that there are two, and when there is one again
    """

    def __init__(self, log: logging.Logger) -> None:
        self._lock, self._names = threading.Lock(), dict[str, _OneName]()
        self._time = TurnTime()
        self._problems = Problems(self._time, 1.0, lambda _: None, log)

    def follows(self, machine: str, boot: str, now_s: float) -> bool:
        """Whether a message of this run counts; monotonic seconds."""
        with self._lock:
            name = self._names.setdefault(machine, _OneName())
            follows = name.follows(boot, now_s)
            self._time.now_s = now_s
            if not follows:
                self._problems.report(machine, Text(NoticeCode.TWO_OF_ONE_NAME, machine=machine, other=boot))
            elif now_s - name.other_s > _BESIDE_S:
                self._problems.clear(machine, NoticeCode.ONE_OF_THIS_NAME, machine=machine)
            return follows

    def two(self, machine: str, now_s: float) -> bool:
        """Whether two gateways of this name were heard within a minute."""
        with self._lock:
            name = self._names.get(machine)
            return name is not None and now_s - name.other_s <= _BESIDE_S
