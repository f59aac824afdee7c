"""Frames on a CANopen bus: the filter for the library, and the latest frames that nodes send without being asked."""

from collections.abc import Collection
from threading import Condition
from time import monotonic
from typing import Any

import can

_SDO_ANSWERS = range(0x581, 0x600)
_SDO_BYTES = 8


def pass_on(network: Any, message: can.Message) -> None:
    """Give the library the frame of a CANopen node. Runs in the receiving thread.

    CiA 301: identifiers have 11 bits, and every SDO frame has eight bytes. Other frames are dropped: the library would
    attribute a frame with a 29-bit identifier to a node, and fail on a short answer.
    """
    identifier, data = message.arbitration_id, message.data
    if message.is_extended_id or message.is_error_frame or message.is_remote_frame or message.is_fd:
        return
    if identifier not in _SDO_ANSWERS or len(data) == _SDO_BYTES:
        network.notify(identifier, data, message.timestamp)


class LatestFrames:
    """The newest frame of each subscribed identifier, and when it came. One thread puts, another reads."""

    def __init__(self) -> None:
        self._came: dict[int, tuple[float, bytes]] = {}
        self._news = Condition()

    def put(self, identifier: int, data: bytes | bytearray, _timestamp: float) -> None:
        """A callback of the canopen library."""
        with self._news:
            self._came[identifier] = monotonic(), bytes(data)
            self._news.notify_all()

    def since(self, oldest_s: float, identifiers: Collection[int], until_s: float) -> dict[int, bytes]:
        """Those that came at monotonic `oldest_s` or later. Waits until `until_s` for missing ones. Blocks."""

        def complete() -> bool:
            return len(self._fresh(oldest_s, identifiers)) == len(set(identifiers))

        with self._news:
            self._news.wait_for(complete, max(0.0, until_s - monotonic()))
            return self._fresh(oldest_s, identifiers)

    def _fresh(self, oldest_s: float, identifiers: Collection[int]) -> dict[int, bytes]:
        came = self._came
        return {i: came[i][1] for i in identifiers if i in came and came[i][0] >= oldest_s}
