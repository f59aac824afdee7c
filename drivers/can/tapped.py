"""A CAN interface with a tap on it."""

from collections import Counter

import can

from drivers.can.receiver import MonotonicInterface
from drivers.tap import Tap


class TappedInterface(MonotonicInterface):
    """A CAN interface with a tap; everything else goes to the inner interface."""

    def __init__(self, inner: can.BusABC, tap: Tap, *, echoes: bool) -> None:
        """`echoes`: the inner interface receives its own frames, which did not come from the bus."""
        self.inner, self._tap, self._echoes = inner, tap, echoes
        self._own: Counter[tuple[int, bool, bytes]] = Counter()
        super().__init__(channel=inner.channel_info)
        tap.note("open")

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        key = msg.arbitration_id, bool(msg.is_extended_id), bytes(msg.data)
        if self._echoes:
            self._own[key] += 1
        self._tap.frame(True, *key)
        self.inner.send(msg, timeout)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        message = self.inner.recv(timeout)
        if message is None or message.is_error_frame or message.is_remote_frame:
            return message, False
        key = message.arbitration_id, bool(message.is_extended_id), bytes(message.data)
        if self._own[key] > 0:
            self._own[key] -= 1
        else:
            self._tap.frame(False, *key)
        return message, False

    def shutdown(self) -> None:
        super().shutdown()
        self._tap.note("close")
        self.inner.shutdown()
