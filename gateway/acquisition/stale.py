"""Reports a channel as stale as soon as it is, even while a read hangs and its runner cannot report."""

from collections.abc import Callable

from gateway.acquisition.board import Board
from gateway.acquisition.runner import Publish
from gateway.acquisition.sample import samples
from gateway.clock import ServiceClock


class StaleWatch:
    """One task for all channels; it wakes when the oldest value is due to go stale, or looks again before any can.

    Parameters
    ----------
    board: has every channel's latest reading
    clock: the one that the readings' monotonic seconds are of
    number: gives the next read's number
    publish: takes the stale readings, once each; time and age are those of the last value
    """

    def __init__(
        self,
        board: Board,
        clock: ServiceClock,
        number: Callable[[], int],
        publish: Publish,
    ) -> None:
        self._board, self._clock, self._number, self._publish = board, clock, number, publish

    async def run(self) -> None:
        """Until cancelled."""
        while True:
            gone, again_s = self._board.expire(self._clock.monotonic())
            if gone:
                self._publish(samples(gone, self._number()))
            await self._clock.sleep_until(again_s)
