"""Signals that end a command without an event loop."""

import signal
from threading import Event, Lock

from gateway.runtime.signals import set_on_signals


class _Waited(Event):
    """Whoever waits holds a lock that `set` needs, as in `Event` itself for a moment of each wait."""

    def __init__(self) -> None:
        super().__init__()
        self.lock = Lock()

    def set(self) -> None:
        with self.lock:
            super().set()


def test_a_signal_at_a_moment_when_the_waiting_thread_holds_the_event_s_lock_ends_the_command() -> None:
    stop, former = _Waited(), {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        set_on_signals(stop)
        with stop.lock:
            signal.raise_signal(signal.SIGTERM)
        assert stop.wait(30.0)
    finally:
        for number, handler in former.items():
            signal.signal(number, handler)
