"""A fake agent that knows only the key and the form of lines, and a connection to it."""

import asyncio
import hmac
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

from drivers.agent.connection import AgentConnection
from drivers.agent.control import AgentControl
from drivers.agent.settings import AgentSettings
from drivers.base import SystemClock
from simulators.devices.loopback import Connection, LoopbackServer

KEY = b"0123456789abcdef0123456789abcdef"
CHALLENGE = "so many"


class Agent:
    """Knows the key and the form of lines, and nothing of the driver; the test says what it sends.

    Where the test says nothing it answers each question with its own words.
    """

    def __init__(self, key: bytes = KEY) -> None:
        self.key = key
        self.greeting = json.dumps({"challenge": CHALLENGE}).encode()
        self.says: list[bytes] = []
        """Sent as they are instead of the next answers, the proof's first."""
        self.answers: dict[str, object] = {}
        """The answers, by what a question asks for."""
        self.heard: list[dict[str, object]] = []
        self.thinks_s = 0.0
        """The pause before each answer."""
        self.session, self.count = b"", 0
        """The session's key and the number of lines of the newest client."""

    def signed(self, text: bytes, *, ahead: int = 0) -> bytes:
        """A line with this text, for the exchange under way or a later one."""
        what = f"agent {self.count + ahead} ".encode() + text
        return hmac.new(self.session, what, "sha256").hexdigest().encode() + b" " + text + b"\n"

    def hear(self, line: bytes) -> bytes:
        """Take a line that was sent to the agent, and return its answer."""
        message = json.loads(line.partition(b" ")[2])
        self.heard.append(message)
        if self.count == 0:
            self.session = hmac.digest(self.key, f"{CHALLENGE} {message['nonce']}".encode(), "sha256")
        answer = self.answers.get(message.get("do", ""), message)
        said = self.says.pop(0) if self.says else self.signed(json.dumps({"answer": answer}).encode())
        self.count += 1
        return said


class AgentClient(Connection):
    """One client of the agent."""

    def __init__(self, agent: Agent) -> None:
        super().__init__()
        self._agent, self._heard = agent, b""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        self._agent.session, self._agent.count = b"", 0
        if self.transport is not None:
            self.transport.write(self._agent.greeting + b"\n")

    def data_received(self, data: bytes) -> None:
        *lines, self._heard = (self._heard + data).split(b"\n")
        for line in lines:
            if self._agent.thinks_s:
                asyncio.get_running_loop().call_later(self._agent.thinks_s, self._answer, line)
            else:
                self._answer(line)

    def _answer(self, line: bytes) -> None:
        if self.transport is not None:
            self.transport.write(self._agent.hear(line))


@asynccontextmanager
async def serving(agent: Agent, folder: Path, timeout_s: float = 5.0) -> AsyncIterator[AgentSettings]:
    """Settings of a client with our key."""
    (folder / "talc.key").write_bytes(KEY)
    server = LoopbackServer(lambda: AgentClient(agent))
    try:
        yield AgentSettings(key_file=folder / "talc.key", port=await server.start(), timeout_s=timeout_s)
    finally:
        await server.stop()


@asynccontextmanager
async def agent_and_connection(folder: Path, timeout_s: float = 5.0) -> AsyncIterator[tuple[Agent, AgentConnection]]:
    agent = Agent()
    async with serving(agent, folder, timeout_s) as settings:
        connection = AgentConnection(settings)
        try:
            yield agent, connection
        finally:
            await connection.close()


@asynccontextmanager
async def agent_and_driver(folder: Path) -> AsyncIterator[tuple[Agent, AgentControl]]:
    """Connected: the machine stands at the origin, nothing is in force."""
    agent = Agent()
    agent.answers = {"status": {"positions": dict.fromkeys("XYZAC", 0.0), "states": {}}, "read": [0.0, 0.0, 0.0]}
    async with serving(agent, folder) as settings:
        nc = AgentControl(settings, SystemClock())
        await nc.connect()
        try:
            yield agent, nc
        finally:
            await nc.close()
