"""A bus of small boards on TCP: each `?` is answered by one line of numbers with blanks between, `nan` for no value."""

import asyncio
import math
from typing import Literal

from drivers.base import BadAnswer, Bus, Clock, ConnectError, Driver, NoAnswer, Quality, Reading, SetupError
from drivers.section import NotEmpty, Port
from drivers.tap import Tap
from gateway.config.extensions import OtherBus
from gateway.config.sections import Device

LONGEST_LINE = 1000


class TextTcpBus:
    """The connection to one board. One request at a time; never retries."""

    kind, units = "text_tcp", (1, 1)

    def __init__(self, name: str, host: str, port: int, timeout_s: float) -> None:
        self.name, self.timeout_s = name, timeout_s
        self._host, self._port = host, port
        self._streams: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None

    async def connect(self) -> None:
        await self.close()
        try:
            async with asyncio.timeout(self.timeout_s):
                self._streams = await asyncio.open_connection(self._host, self._port, limit=LONGEST_LINE)
        except (OSError, TimeoutError) as error:
            raise ConnectError(f"{self._host}:{self._port}: {error or 'no connection'}", bus=self.name) from error

    async def ask(self) -> list[float]:
        """The numbers of one line. Any fault closes the connection: a later answer could belong to this request."""
        if self._streams is None:
            raise ConnectError("not connected", bus=self.name, hint="connect first")
        reader, writer = self._streams
        try:
            async with asyncio.timeout(self.timeout_s):
                writer.write(b"?\n")
                await writer.drain()
                line = await reader.readuntil(b"\n")
            return [float(word) for word in line.split()]
        except BaseException as error:
            await self.close()
            match error:
                case TimeoutError():
                    raise NoAnswer(f"no answer within {self.timeout_s:g} s", bus=self.name) from error
                case OSError() | asyncio.IncompleteReadError():
                    raise ConnectError("the connection is lost", bus=self.name) from error
                case ValueError() | asyncio.LimitOverrunError():
                    raise BadAnswer(f"no line of numbers: {error}", bus=self.name) from error
            raise

    async def close(self) -> None:
        if self._streams is not None:
            self._streams[1].close()
            self._streams = None


class TextTcpDevice:
    """The board's numbers as channels."""

    def __init__(self, device: Device, bus: TextTcpBus, clock: Clock) -> None:
        self.device, self.channels = device.name, tuple(device.channels)
        self._numbers, self._bus, self._clock = device.channels, bus, clock

    async def connect(self) -> None:
        await self.read()

    async def read(self, *, again: bool = False) -> list[Reading]:
        values = await self._bus.ask()
        if (most := max(self._numbers.values())) >= len(values):
            raise BadAnswer(f"{len(values)} numbers; channel number {most} is not there", device=self.device)
        utc, now = self._clock.utc(), self._clock.monotonic()
        return [
            Reading(
                name, values[i], "degC", Quality.GOOD if math.isfinite(values[i]) else Quality.SENSOR_FAULT, utc, now
            )
            for name, i in self._numbers.items()
        ]

    async def close(self) -> None:
        """The device has nothing of its own to close."""


class TextTcpSection(OtherBus):
    """Boards that answer with lines of text."""

    kind: Literal["text_tcp"]
    """`text_tcp`."""
    host: NotEmpty
    """Host of the board."""
    port: Port = 2000
    """Its TCP port."""

    @property
    def place(self) -> str:
        return f"{self.host}:{self.port}"

    def bus(self, tap: Tap | None) -> TextTcpBus:
        return TextTcpBus(self.name, self.host, self.port, self.timeout_s)

    def driver(self, device: Device, bus: Bus, clock: Clock) -> Driver:
        if device.profile != "numbers":
            raise SetupError(f"profile '{device.profile}': expected 'numbers'", bus=self.name, device=device.name)
        if not isinstance(bus, TextTcpBus):
            raise SetupError("another package's bus", bus=self.name, device=device.name)
        return TextTcpDevice(device, bus, clock)
