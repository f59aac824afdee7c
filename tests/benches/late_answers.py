"""Late answers of a device on a line, which come after something else was asked."""

from collections.abc import Collection, Sequence
from time import monotonic


class Late:
    """A fault that delays some senders' answers, in the order of the requests, as a single device always does.

    The last answer of each sender is kept. It comes in the time of another answer, just before that one.

    senders: who is late
    takes_s: how long they, and who answers after a late answer, then take for each answer, s
    before: whose answers the late ones come before. None: those of the same sender, so that each request is met by the
        answer to the one before. Nobody: none comes before `let_go`
    """

    def __init__(self, senders: Collection[int], takes_s: float, before: Collection[int] | None = None) -> None:
        self._senders, self._takes_s = senders, takes_s
        self._before = senders if before is None else before
        self._kept: dict[int, bytes] = {}
        self._gone, self._free_s = False, 0.0

    def let_go(self) -> None:
        """From now on they answer one request after the other; the answer that was kept comes first."""
        self._before, self._gone = {*self._senders, *self._before}, True

    def __call__(self, sender: int, frame: bytes) -> Sequence[tuple[float, bytes]]:
        is_late = sender in self._senders
        heard: list[tuple[float, bytes]] = []
        if sender in self._before:
            due = (sender,) if is_late else tuple(self._kept)
            heard = [(0.0, self._kept.pop(one)) for one in due if one in self._kept]
        if is_late and not self._gone:
            self._kept[sender] = frame
        elif is_late or heard:
            self._free_s = max(self._free_s, monotonic()) + self._takes_s
            heard.append((self._free_s - monotonic(), frame))
        else:
            heard.append((0.0, frame))
        return heard
