"""Frames on a CANopen bus: which of them the library gets, and the latest of those that nodes send by themselves."""

from collections.abc import Collection
from threading import Condition
from time import monotonic
from typing import Any

import can

_SDO_ANSWERS = range(0x581, 0x600)
_SDO_BYTES = 8


class NodeFrames(can.Listener):
    """Passes the frames of CANopen nodes on, and ends the receiving thread when the interface fails.

    CiA 301: identifiers of 11 bits, and every SDO frame has eight bytes. What is otherwise is not for us: the library
    would take a frame with an identifier of 29 bits for a node's, and break on a short answer. When the interface
    fails, python-can by itself would print a traceback or try for ever.
    """

    def __init__(self, network: Any) -> None:
        self._network = network

    def on_message_received(self, msg: can.Message) -> None:
        """In the receiving thread."""
        identifier, data = msg.arbitration_id, msg.data
        if msg.is_extended_id or msg.is_error_frame or msg.is_remote_frame or msg.is_fd:
            return
        if identifier not in _SDO_ANSWERS or len(data) == _SDO_BYTES:
            self._network.notify(identifier, data, msg.timestamp)

    def on_error(self, exc: Exception) -> None:  # noqa: ARG002 - python-can keeps it in Notifier.exception
        """In the receiving thread."""
        if self._network.notifier is not None:
            self._network.notifier.stop(0.0)


class LatestFrames:
    """The newest frame of each identifier that is listened for, and when it came. One thread puts, another reads."""

    def __init__(self) -> None:
        self._came: dict[int, tuple[float, bytes]] = {}
        self._news = Condition()

    def put(self, identifier: int, data: bytes | bytearray, _timestamp: float) -> None:
        """A callback of the canopen library."""
        with self._news:
            self._came[identifier] = monotonic(), bytes(data)
            self._news.notify_all()

    def since(self, oldest_s: float, identifiers: Collection[int], until_s: float) -> dict[int, bytes]:
        """Those that came at monotonic `oldest_s` or later; waits for the missing until `until_s`. Blocks."""

        def complete() -> bool:
            return len(self._fresh(oldest_s, identifiers)) == len(set(identifiers))

        with self._news:
            self._news.wait_for(complete, max(0.0, until_s - monotonic()))
            return self._fresh(oldest_s, identifiers)

    def _fresh(self, oldest_s: float, identifiers: Collection[int]) -> dict[int, bytes]:
        came = self._came
        return {i: came[i][1] for i in identifiers if i in came and came[i][0] >= oldest_s}
