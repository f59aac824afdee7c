"""The agent of deploy/nc/linuxcnc in the real LinuxCNC, seen from the wire: what it refuses, and in which words.

Who may use it is among the clauses of tests/gateway/commissioning/agent_test/test_agent_test_linuxcnc.py. Needs
Debian's linuxcnc-uspace.
"""

import asyncio
import hmac
import json
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from simulators.linuxcnc.machine import machine

pytestmark = pytest.mark.peer

KEY = "0123456789abcdef0123456789abcdef"


class WireClient:
    """A client that knows only the wire protocol."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer
        self.session, self.count = b"", 0

    async def hear(self) -> dict[str, Any]:
        async with asyncio.timeout(60.0):
            line = await self.reader.readline()
        if not line.startswith(b"{"):
            mac, _, text = line.strip().partition(b" ")
            assert mac == self.mac("agent", text)
            self.count += 1
            line = text
        answer: dict[str, Any] = json.loads(line)
        return answer

    def mac(self, who: str, text: bytes) -> bytes:
        return hmac.new(self.session, f"{who} {self.count} ".encode() + text, "sha256").hexdigest().encode()

    def say(self, text: bytes) -> bytes:
        signed = self.mac("client", text) + b" " + text + b"\n"
        self.writer.write(signed)
        return signed

    async def ask(self, **command: Any) -> dict[str, Any]:
        self.say(json.dumps(command).encode())
        return await self.hear()

    async def ended(self) -> bool:
        async with asyncio.timeout(60.0):
            try:
                return await self.reader.read() == b""
            except ConnectionResetError:  # closed with some of what we said unread
                return True

    async def login(self) -> dict[str, Any]:
        challenge = (await self.hear())["challenge"]
        self.session = hmac.digest(KEY.encode(), f"{challenge} here".encode(), "sha256")
        return await self.ask(nonce="here")


@pytest.fixture
async def port(tmp_path: Path) -> AsyncIterator[int]:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        async with machine(tmp_path, listener, KEY):
            yield listener.getsockname()[1]


@asynccontextmanager
async def client(port: int) -> AsyncIterator[WireClient]:
    """Logged in, with the control claimed by owner 1."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    try:
        it = WireClient(reader, writer)
        assert "status" in (await it.login())["answer"]["commands"]
        assert await it.ask(do="claim", owner=1, silence_s=60.0, ramp_um_per_s=1.0) == {"answer": None}
        async with asyncio.timeout(60.0):
            while await it.ask(do="heartbeat", owner=1) != {"answer": True}:
                await asyncio.sleep(0.01)
        yield it
    finally:
        writer.close()
        with suppress(ConnectionError):
            await writer.wait_closed()


ERRORS = {"do": "write_errors", "owner": 1, "errors": [0] * 9, "radius_mm": 120, "bound_um": [50, 50, 50]}
REFUSED: list[tuple[dict[str, Any], str]] = [
    ({"do": "shell"}, "expected one of"),
    ({"do": "write", "um": [0, 0, 200.1]}, "beyond [TALC] BOUND"),
    ({"do": "write", "um": [0, 0]}, "three numbers"),
    ({"do": "write", "um": [float("nan"), 0, 0]}, "finite"),
    ({"do": "write", "um": "high"}, "list of three"),
    ({"do": "write", "um": [1, 0, 0]}, "no heartbeat"),
    ({"do": "write", "um": [1, 0, 0], "owner": 2}, "no heartbeat"),
    ({**ERRORS, "errors": [0] * 8}, "list of nine"),
    ({**ERRORS, "errors": [0] * 8 + [float("inf")]}, "finite"),
    ({**ERRORS, "radius_mm": 0}, "radius_mm = 0: expected more than 0"),
    ({**ERRORS, "radius_mm": -120}, "radius_mm = -120: expected more than 0"),
    ({**ERRORS, "bound_um": [50, -1, 50]}, "expected 0 or more"),
    ({**ERRORS, "owner": 2}, "no heartbeat"),
    ({"do": "errors", "radius_mm": 0}, "radius_mm = 0: expected more than 0"),
    ({"do": "claim", "owner": 1, "silence_s": 0, "ramp_um_per_s": 1}, "silence_s 0.05"),
    ({"do": "claim", "owner": 1, "silence_s": 10**400, "ramp_um_per_s": 1}, "finite"),
    ({"do": "write", "um": [0, -(10**400), 0], "owner": 1}, "finite"),
    ({"do": "probe", "number": 1, "valid_for_s": 10**400}, "finite"),
    ({"do": "claim", "owner": 2, "silence_s": 1, "ramp_um_per_s": 1}, "belongs to gateway 1"),
    ({"do": "heartbeat", "owner": 2}, "belongs to gateway 1"),
    ({"do": "heartbeat", "owner": True}, "owner = True"),
    ({"do": "probe", "number": 0, "valid_for_s": 1}, "number = 0"),
    ({"do": "probe", "number": 1}, "valid_for_s = None"),
    ({"do": "probe", "number": 1, "valid_for_s": -1}, "valid_for_s = -1: expected 0 or more"),
    ({"do": "probing", "number": "1"}, "number = '1'"),
]


async def test_what_is_out_of_bounds_is_refused_and_the_connection_stays_open(port: int) -> None:
    async with client(port) as it:
        for command, says in REFUSED:
            assert says in (await it.ask(**command))["error"]
        # Any ramp is a right one: what the control's own slew does not allow is done at that.
        assert await it.ask(do="claim", owner=1, silence_s=86400, ramp_um_per_s=1e9) == {"answer": None}
        it.say(b"[" * 3000)
        assert "error" in await it.hear()
        assert (await it.ask(do="read"))["answer"] == [0.0, 0.0, 0.0]
        it.writer.write(b"x" * 10000)
        assert await it.ended()
