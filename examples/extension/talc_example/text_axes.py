"""A control that is only read: a board answers `?` with the positions of X, Y, Z, A, C and the spindle's speed."""

import math
from collections.abc import Iterable
from typing import ClassVar, Literal

from drivers.base import BadAnswer, Clock, SetupError
from drivers.nc import NcSnapshot
from drivers.only_read import ONLY_READ, OnlyRead
from drivers.section import NotEmpty, Port, ServerTime
from gateway.config.extensions import ControlSection
from talc_example.text_tcp import TextTcpBus

AXES = ("X", "Y", "Z", "A", "C")


class TextAxes(OnlyRead):
    """One machine. Constructed without the network; never retries."""

    def __init__(self, line: TextTcpBus, clock: Clock) -> None:
        self._line, self._clock = line, clock

    async def connect(self) -> None:
        await self._line.connect()
        await self.snapshot()

    async def close(self) -> None:
        await self._line.close()

    async def snapshot(self) -> NcSnapshot:
        values = await self._line.ask()
        if len(values) != len(AXES) + 1 or not all(map(math.isfinite, values)):
            raise BadAnswer(f"{values}: expected {', '.join(AXES)} and the spindle's speed", device="nc")
        *positions, speed = values
        return NcSnapshot(
            self._clock.utc(),
            self._clock.monotonic(),
            dict(zip(AXES, positions, strict=True)),
            {"spindle_speed": speed},
            cannot_probe=ONLY_READ,
        )


class TextAxesSection(ControlSection):
    """A machine whose axes a board reports."""

    kind: Literal["text_axes"]
    """`text_axes`."""
    host: NotEmpty
    """Host of the board."""
    port: Port = 2001
    """Its TCP port."""
    timeout_s: ServerTime = 1.0
    """How long one answer may take."""

    only_read: ClassVar[bool] = True

    @property
    def address(self) -> str:
        return f"{self.host}:{self.port}"

    def known_states(self) -> Iterable[str]:
        return ("spindle_speed",)

    def control(self, poses_deg: object, states: Iterable[str], clock: Clock) -> TextAxes:
        if self.timeout_s > self.period_s:
            raise SetupError(f"timeout_s = {self.timeout_s:g}: expected at most period_s = {self.period_s:g}")
        return TextAxes(TextTcpBus("nc", self.host, self.port, self.timeout_s), clock)
