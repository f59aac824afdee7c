"""Receives from a CAN interface of python-can without using the wall clock.

python-can's `recv` and `Notifier` use `time.time()`: when the clock was set back by an hour on a silent bus, they
waited an hour longer, so that closing took seconds and left a thread behind.
"""

from collections.abc import Callable
from threading import Event, Thread, current_thread
from time import monotonic

import can

_WAIT_S = 0.1
"""How long one wait for a frame lasts, and so how long stopping may have to wait for the thread."""
_MOST_WAIT_S = 2.0
"""Longest wait for a thread that is stuck in a driver."""


class MonotonicInterface(can.BusABC):
    """A mixin whose `recv` keeps its deadline when the clock is set; goes before python-can's class."""

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The next frame, or None after `timeout` seconds. Raises what the interface raises."""
        deadline = None if timeout is None else monotonic() + timeout
        left = timeout
        while True:
            message, filtered = self._recv_internal(left)
            if message is not None and (filtered or self._matches_filters(message)):
                return message
            if deadline is not None and (left := deadline - monotonic()) <= 0:
                return None


class Receiver:
    """A thread that receives frames from an interface until the interface fails or the thread is stopped."""

    def __init__(
        self,
        interface: can.BusABC,
        on_message: Callable[[can.Message], None],
        on_lost: Callable[[], None] = lambda: None,
    ) -> None:
        """Starts at once and calls both in the thread; `on_lost` when the interface has failed, which ends it."""
        self.exception: Exception | None = None
        """Why the interface failed."""
        self._interface, self._on_message, self._on_lost = interface, on_message, on_lost
        self._stopping = Event()
        self._thread = Thread(target=self._run, name=f"receiving {interface.channel_info}", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the thread and wait for it. Blocks."""
        self._stopping.set()
        if self._thread is not current_thread():
            self._thread.join(_MOST_WAIT_S)

    def _run(self) -> None:
        try:
            while not self._stopping.is_set():
                message = self._interface.recv(_WAIT_S)
                if message is not None:
                    self._on_message(message)
        except Exception as error:  # noqa: BLE001 - any error of a driver or port ends this interface
            self.exception = error
            self._on_lost()
