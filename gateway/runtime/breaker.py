"""The breaker: when to ask again after a failure. A small object on monotonic time, without tasks or sleep."""


class Breaker:
    """Asks a failing device less and less often: after 1, 2, 4 ... times the shortest wait, up to the longest.

    Parameters
    ----------
    shortest_s: wait after the first failure, s, > 0
    longest_s: wait that is never exceeded, s, >= shortest_s
    """

    def __init__(self, shortest_s: float, longest_s: float) -> None:
        if not 0 < shortest_s <= longest_s:
            raise ValueError(
                f"shortest_s = {shortest_s:g}, longest_s = {longest_s:g}: expected 0 < shortest <= longest"
            )
        self._shortest, self._longest = shortest_s, longest_s
        self._failures = 0
        self._retry_at = float("-inf")

    @property
    def failing(self) -> bool:
        """Whether the last outcome was a failure."""
        return self._failures > 0

    @property
    def retry_at(self) -> float:
        """Monotonic seconds from which it may be asked."""
        return self._retry_at

    def allows(self, now_s: float) -> bool:
        """Whether it may be asked now."""
        return now_s >= self._retry_at

    def overdue(self, now_s: float) -> bool:
        """Whether it has waited so long that it must be asked, whatever that costs the others."""
        return now_s >= self._retry_at + self._longest

    def succeeded(self) -> None:
        """Record an answer: the next wait is the shortest again."""
        self._failures, self._retry_at = 0, float("-inf")

    def failed(self, now_s: float) -> None:
        """Record a failure at `now_s`; for a polled device the time at which it was due, so that waits do not drift."""
        # A wait doubles only until it reaches the longest; the exponent is bounded so that it cannot overflow.
        self._retry_at = now_s + min(self._shortest * 2.0 ** min(self._failures, 60), self._longest)
        self._failures += 1
