"""Reports a control that answers so slowly that periods are skipped."""

import logging

from gateway.polling import Notice, Notify

log = logging.getLogger(__name__)

_IN_A_ROW = 5
"""One slow period is no news: a connection, a computer that was busy."""


class NcPace:
    """One control's periods, in order.

    period_s: time between two of them; notify: called when it begins to be too short, and when it suffices again
    """

    def __init__(self, period_s: float, notify: Notify) -> None:
        self._period, self._notify = period_s, notify
        self._slow = self._fast = 0
        self._told = False

    def worked(self, skipped: int) -> None:
        """After each period with a connection; skipped: periods that its work lasted beyond its own."""
        self._slow, self._fast = (self._slow + 1, 0) if skipped else (0, self._fast + 1)
        if not self._told and self._slow >= _IN_A_ROW:
            text = (
                f"a cycle of reading and writing takes longer than [nc] period_s = {self._period:g}: offsets follow "
                "more slowly than configured. Raise period_s, or let the control report changes ([nc] subscribe_s)"
            )
            self._tell(text, ended=False)
        elif self._told and self._fast >= _IN_A_ROW:
            self._tell("cycles are within period_s again", ended=True)

    def _tell(self, text: str, *, ended: bool) -> None:
        self._told = not ended
        log.warning("NC: %s", text)
        self._notify(Notice("pace of NC", f"NC: {text}", ended=ended))
