"""A control that is read by HTTP from its MTConnect agent (ANSI/MTC1.4, requests `probe` and `current`)."""

import asyncio
import http.client
import socket
from contextlib import suppress
from urllib.parse import urlsplit

from drivers.base import BadAnswer, Clock, ConnectError, NoAnswer
from drivers.mtconnect.document import AgentError, data_items, elements, latest_values
from drivers.mtconnect.items import POSITION_UNITS, SPEED_UNITS, SWITCHED, factors, number
from drivers.mtconnect.settings import AXES, MtConnectSettings
from drivers.nc import LINEAR_AXES, NcSnapshot, OperatingMode, ProgramState
from drivers.only_read import ONLY_READ, OnlyRead

MOST_BYTES = 8_000_000
"""Of one answer."""
_LARGEST_MM = 100_000.0
MODES = {
    "AUTOMATIC": OperatingMode.AUTO,
    "SEMI_AUTOMATIC": OperatingMode.AUTO,
    "MANUAL": OperatingMode.JOG,
    "MANUAL_DATA_INPUT": OperatingMode.MDA,
}
PROGRAMS = {
    "ACTIVE": ProgramState.RUNNING,
    "READY": ProgramState.STOPPED,
    "STOPPED": ProgramState.STOPPED,
    "PROGRAM_COMPLETED": ProgramState.STOPPED,
    "WAIT": ProgramState.WAITING,
    "FEED_HOLD": ProgramState.INTERRUPTED,
    "INTERRUPTED": ProgramState.INTERRUPTED,
    "PROGRAM_STOPPED": ProgramState.INTERRUPTED,
    "OPTIONAL_STOP": ProgramState.INTERRUPTED,
}


class MtConnectControl(OnlyRead):
    """One machine of an MTConnect agent. Constructed without the network; never retries."""

    def __init__(self, settings: MtConnectSettings, clock: Clock) -> None:
        self._settings, self._clock = settings, clock
        self._factors: dict[str, float] = {}

    async def connect(self) -> None:
        """The agent must describe every configured data item, with a type and a unit that fit.

        Raises WrongDevice if it does not.
        """
        self._factors = {}
        body = await self._get("probe")
        try:
            found = data_items(body)
        except ValueError as error:
            raise BadAnswer(f"probe: {error}", device="nc") from error
        self._factors = factors(self._settings, found)
        await self.snapshot()

    async def close(self) -> None:
        """Each request has a connection of its own."""
        self._factors = {}

    async def snapshot(self) -> NcSnapshot:
        """Raises BadAnswer while an axis has no position: an agent that has lost its control reports UNAVAILABLE."""
        if not self._factors:
            raise ConnectError("not connected", device="nc", hint="connect first")
        body, settings = await self._get("current"), self._settings
        try:
            told = latest_values(body)
        except ValueError as error:
            raise BadAnswer(f"current: {error}", device="nc") from error
        if missing := [axis for axis in AXES if settings.positions[axis] not in told]:
            raise BadAnswer(f"no position of {', '.join(missing)}: the agent says UNAVAILABLE", device="nc")
        positions = {axis: self._value(axis, settings.positions[axis], told) for axis in AXES}
        for axis, origin in zip(LINEAR_AXES, settings.origin_mm, strict=True):
            if abs(positions[axis]) > _LARGEST_MM:
                raise BadAnswer(f"{axis} = {positions[axis]:g} mm: beyond 100 m", device="nc")
            positions[axis] -= origin
        states = {name: self._value(name, item, told) for name, item in settings.states.items() if item in told}
        return NcSnapshot(
            time=self._clock.utc(),
            monotonic_s=self._clock.monotonic(),
            positions=positions,
            states={name: abs(value) if name in SPEED_UNITS else value for name, value in states.items()},
            mode=MODES.get(told.get(settings.mode, ""), OperatingMode.UNKNOWN),
            program=PROGRAMS.get(told.get(settings.program, ""), ProgramState.UNKNOWN),
            tool=self._tool(told.get(settings.tool, "")),
            ready=False if told.get(settings.emergency_stop) == "TRIGGERED" else None,
            cannot_probe=ONLY_READ,
        )

    def _value(self, name: str, item: str, told: dict[str, str]) -> float:
        text = told[item]
        if text in SWITCHED and name not in POSITION_UNITS and name not in SPEED_UNITS:
            return SWITCHED[text]
        return number(item, text) * self._factors[name]

    def _tool(self, text: str) -> int | None:
        """MTConnect's tool numbers are text; only whole ones are reported."""
        return int(text) if text.isascii() and text.isdecimal() and len(text) <= 9 else None

    async def _get(self, request: str) -> bytes:
        """The body of the answer. Raises NoAnswer, ConnectError, BadAnswer."""
        settings = self._settings
        exchange = _Exchange(settings.url, f"/{settings.machine}/{request}" if settings.machine else f"/{request}")
        try:
            async with asyncio.timeout(settings.timeout_s):
                status, body = await asyncio.to_thread(exchange.run, settings.timeout_s)
        except TimeoutError as error:
            what = f"{settings.url}: no answer to {request} within {settings.timeout_s:g} s"
            raise NoAnswer(what, device="nc") from error
        except (OSError, http.client.HTTPException) as error:
            raise ConnectError(f"{settings.url}: {str(error) or type(error).__name__}", device="nc") from error
        finally:
            exchange.hang_up()
        if len(body) > MOST_BYTES:
            raise BadAnswer(f"{request}: more than {MOST_BYTES} bytes", device="nc")
        if status != http.HTTPStatus.OK:
            raise BadAnswer(f"{request}: HTTP status {status}{_why(body)}", device="nc", hint="see url and machine")
        return body


class _Exchange:
    """One request and its answer, on a connection of its own, in a thread of its own."""

    def __init__(self, url: str, path: str) -> None:
        parts = urlsplit(url)
        self._host, self._port = parts.hostname or "", parts.port or http.client.HTTP_PORT
        self._path = parts.path.rstrip("/") + path
        self._socket: socket.socket | None = None
        self._hung_up = False

    def run(self, timeout_s: float) -> tuple[int, bytes]:
        """HTTP status and body, at most one byte more than MOST_BYTES. Blocks."""
        connection = http.client.HTTPConnection(self._host, self._port, timeout=timeout_s)
        try:
            connection.connect()
            self._socket = connection.sock
            if self._hung_up:
                raise TimeoutError
            connection.request("GET", self._path, headers={"Accept": "text/xml", "Connection": "close"})
            response = connection.getresponse()
            return response.status, response.read(MOST_BYTES + 1)
        finally:
            connection.close()

    def hang_up(self) -> None:
        """Ends a thread that still reads: an agent that sends a byte a second would keep it for ever."""
        self._hung_up = True
        if self._socket is not None:
            with suppress(OSError):  # it has ended
                self._socket.shutdown(socket.SHUT_RDWR)


def _why(body: bytes) -> str:
    """What an MTConnect agent says of its refusal."""
    try:
        elements(body)
    except AgentError as error:
        return f", {error}"
    except ValueError:
        pass
    return ""
