"""A telemetry publisher whose session has opened when it is entered, however slow the computer is."""

from typing import Self

from gateway.telemetry.publisher import TelemetryPublisher
from tests.benches.waits import LIMIT_S


class OpenPublisher(TelemetryPublisher):
    """Waits on entry until the first attempt to open its session has ended."""

    async def __aenter__(self) -> Self:
        await super().__aenter__()
        await self.tried(LIMIT_S)
        return self
