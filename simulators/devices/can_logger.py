"""An emulated CAN temperature logger: sends its inputs unasked, int16 little-endian in 0.1 degC, four to a frame."""

import asyncio
import struct
from collections.abc import Callable, Sequence

from simulators.devices.slcan_adapter import CanFrame
from simulators.devices.source import Faults, SensorFault, ValueSource

_SENT = {SensorFault.OPEN: 0x7FFF, SensorFault.SHORT: -0x8000, SensorFault.OVER: 9000, SensorFault.UNDER: -2500}


class CanLogger:
    """Sends to `send` every `cycle_s` (real time), identifiers `first`, `first + 1`, ..., between start and stop."""

    def __init__(
        self,
        source: ValueSource,
        send: Callable[[Sequence[CanFrame]], None],
        *,
        first: int = 0x300,
        cycle_s: float = 0.02,
    ) -> None:
        self._source, self._send, self._first, self._cycle_s = source, send, first, cycle_s
        self._timer: asyncio.TimerHandle | None = None
        self.faults = Faults()

    def on_frame(self, identifier: int, data: bytes) -> Sequence[CanFrame]:  # noqa: ARG002 - it does not listen
        return ()

    def start(self) -> None:
        self._timer = asyncio.get_running_loop().call_later(self._cycle_s, self._tick)

    def stop(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _tick(self) -> None:
        self.start()
        if not self.faults.silent:
            self._send(self.frames())

    def frames(self) -> list[CanFrame]:
        """The frames of one cycle."""
        counts = [
            _SENT[fault] if (fault := self.faults.by_channel.get(i)) is not None else round(value * 10)
            for i, value in enumerate(self._source())
        ]
        groups = [counts[start : start + 4] for start in range(0, len(counts), 4)]
        return [(self._first + i, struct.pack(f"<{len(group)}h", *group)) for i, group in enumerate(groups)]
