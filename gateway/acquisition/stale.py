"""Reports a channel as soon as it goes stale, even while a read hangs and its runner cannot report it."""

from collections.abc import Callable

from gateway.acquisition.board import Board
from gateway.acquisition.runner import Publish
from gateway.model.sample import samples
from gateway.runtime.clocks import ServiceClock


class StaleWatch:
    """One task for all channels. It wakes when the oldest value is due to go stale, or before any other can.

    Parameters
    ----------
    board: holds every channel's latest reading
    clock: the source of the readings' monotonic seconds
    number: returns the sequence number of the next read
    publish: receives each stale reading once; its time and age are those of the last value
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
        """Run until cancelled."""
        while True:
            gone, again_s = self._board.expire(self._clock.monotonic())
            if gone:
                self._publish(samples(gone, self._number()))
            await self._clock.sleep_until(again_s)
