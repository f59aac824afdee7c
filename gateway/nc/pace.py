"""Reports a control that answers so slowly that periods are skipped."""

from gateway.model.codes import NoticeCode
from gateway.model.text import Text
from gateway.runtime.problems import Problems

_SUBJECT = "pace of NC"
_IN_A_ROW = 5
"""One slow period is no news: a connection, a computer that was busy."""


class NcPace:
    """One control's periods, in order.

    period_s: time between two of them; problems: told when it begins to be too short, and when it suffices again
    """

    def __init__(self, period_s: float, problems: Problems) -> None:
        self._period, self._problems = period_s, problems
        self._slow = self._fast = 0

    def worked(self, skipped: int) -> None:
        """After each period with a connection; skipped: periods that its work lasted beyond its own."""
        self._slow, self._fast = (self._slow + 1, 0) if skipped else (0, self._fast + 1)
        if self._slow >= _IN_A_ROW:
            self._problems.report(_SUBJECT, Text(NoticeCode.NC_SLOW, period_s=self._period))
        elif self._fast >= _IN_A_ROW:
            self._problems.clear(_SUBJECT, NoticeCode.NC_IN_TIME)
