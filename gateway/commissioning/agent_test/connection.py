"""A client that knows only the wire protocol. It can also send what no gateway sends."""

import asyncio
import hmac
import json
import math
import secrets
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from typing import Any

from drivers.section import host_and_port

LONGEST_ANSWER = 65536


class Broken(Exception):
    """A clause does not hold. The message says what came instead."""


class Unreachable(Exception):
    """Nothing can be tried: no connection, or the agent does not let us in."""


class Told(Exception):
    """The agent's signed error."""


@dataclass(frozen=True, slots=True)
class AgentUnderTest:
    """Where the agent is, and the key that it shares."""

    host: str
    port: int
    key: bytes
    timeout_s: float = 2.0
    """How long an answer may take, and how long the control may take until something is in force."""


class BareConnection:
    """One connection, greeted by the agent."""

    def __init__(self, target: AgentUnderTest, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.target, self._reader, self._writer = target, reader, writer
        self.challenge, self.first = "", b""
        """The first line that was said."""
        self._session, self._count = b"", 0

    async def greeted(self) -> dict[str, Any]:
        """The agent's first line."""
        told = _json(await self.hear())
        if not isinstance(told, dict) or not isinstance(told.get("challenge"), str):
            raise Broken(f"a first line of {excerpt(told)}")
        self.challenge = told["challenge"]
        return told

    def login_line(self, key: bytes, *, reads: bool = False) -> bytes:
        """The first line of a client with this key. reads: of one that only reads"""
        nonce = secrets.token_hex(32)
        self._session, self._count = hmac.digest(key, f"{self.challenge} {nonce}".encode(), "sha256"), 0
        self.first = self.signed(json.dumps({"nonce": nonce, **({"reads": True} if reads else {})}).encode())
        return self.first

    async def login(self, *, reads: bool = False) -> Any:
        """The greeting. Raises Told for a refusal, Broken for an answer that is not signed with the key."""
        await self.say(self.login_line(self.target.key, reads=reads))
        return await self.hear_answer()

    async def ask(self, do: str, **arguments: object) -> Any:
        """Raises Told, and Broken for an answer that is not signed."""
        return await self.ask_text(json.dumps({"do": do, **arguments}))

    async def ask_text(self, text: str) -> Any:
        """The same for any text."""
        await self.say(self.signed(text.encode()))
        return await self.hear_answer()

    def signed(self, text: bytes) -> bytes:
        """The next line of this session."""
        return self._mac("client", text) + b" " + text + b"\n"

    def signed_later(self, text: bytes) -> bytes:
        """The line after the next one."""
        self._count += 1
        try:
            return self.signed(text)
        finally:
            self._count -= 1

    async def say(self, data: bytes) -> None:
        """Raises Broken when the agent has closed the connection."""
        self._writer.write(data)
        try:
            await self._writer.drain()
        except OSError:
            raise Broken("the end of the connection") from None

    async def hear(self) -> bytes:
        """One line. Raises Broken."""
        try:
            async with asyncio.timeout(self.target.timeout_s):
                return (await self._reader.readuntil(b"\n"))[:-1]
        except TimeoutError:
            raise Broken(f"nothing within {self.target.timeout_s:g} s") from None
        except asyncio.LimitOverrunError:
            raise Broken(f"a line of more than {LONGEST_ANSWER} bytes") from None
        except (asyncio.IncompleteReadError, OSError):
            raise Broken("the end of the connection") from None

    async def check_ends(self, within_s: float | None = None) -> None:
        """Raises Broken unless the agent ends the connection; an unsigned error before that is allowed."""
        try:
            async with asyncio.timeout(within_s or self.target.timeout_s):
                rest = await self._reader.read(LONGEST_ANSWER)
                while rest:
                    if not rest.startswith(b"{"):
                        raise Broken(f"an answer: {excerpt(rest)}")
                    rest = await self._reader.read(LONGEST_ANSWER)
        except TimeoutError:
            raise Broken("a connection that stays open") from None
        except OSError:
            pass

    async def hear_answer(self) -> Any:
        """The answer to the oldest question without one. Raises as `ask`."""
        line = await self.hear()
        mac, _, text = line.partition(b" ")
        if self._count == 0 and line.startswith(b"{"):
            told = _json(line)
            raise Told(str(told["error"]) if isinstance(told, dict) and "error" in told else excerpt(line))
        if not hmac.compare_digest(self._mac("agent", text), mac):
            raise Broken(f"an answer that is not signed for this question: {excerpt(line)}")
        self._count += 1
        answer = _json(text)
        if not isinstance(answer, dict) or not answer.keys() & {"answer", "error"}:
            raise Broken(f"{excerpt(answer)}, with neither answer nor error")
        if "error" in answer:
            raise Told(str(answer["error"]))
        return answer["answer"]

    def _mac(self, who: str, text: bytes) -> bytes:
        return hmac.new(self._session, f"{who} {self._count} ".encode() + text, "sha256").hexdigest().encode()

    async def close(self) -> None:
        self._writer.close()
        with suppress(OSError):
            await self._writer.wait_closed()


@asynccontextmanager
async def connected(target: AgentUnderTest) -> AsyncIterator[BareConnection]:
    """Greeted, not logged in. Raises Unreachable."""
    try:
        async with asyncio.timeout(target.timeout_s):
            reader, writer = await asyncio.open_connection(target.host, target.port, limit=LONGEST_ANSWER)
    except (OSError, TimeoutError) as error:
        where = host_and_port(target.host, target.port)
        raise Unreachable(f"{where}: {str(error) or 'no connection'}") from None
    agent = BareConnection(target, reader, writer)
    try:
        await agent.greeted()
        yield agent
    finally:
        await agent.close()


@asynccontextmanager
async def logged_in(target: AgentUnderTest) -> AsyncIterator[BareConnection]:
    """Raises Unreachable if the agent refuses for longer than it may take to notice that an earlier client has gone."""
    loop = asyncio.get_running_loop()
    until = loop.time() + 3.0 + target.timeout_s
    while True:
        async with connected(target) as agent:
            try:
                await agent.login()
            except Told as refusal:
                if loop.time() > until:
                    raise Unreachable(f"the agent refuses the login: {refusal}") from None
            else:
                yield agent
                return
        await asyncio.sleep(0.1)


def _json(text: bytes) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        raise Broken(f"{excerpt(text)}, which is not JSON") from None


def excerpt(value: object) -> str:
    """A value in a message, in one line and not too long."""
    text = value.decode(errors="replace") if isinstance(value, bytes) else json.dumps(value, default=repr)
    return text if len(text) <= 100 else text[:97] + "..."


def is_finite_number(value: object) -> bool:
    """Whether it is a number of JSON that fits a float; a truth value is not a number."""
    with suppress(OverflowError):  # JSON's integers may be longer
        return not isinstance(value, bool) and isinstance(value, (int, float)) and math.isfinite(value)
    return False


def three_numbers(value: object, what: str) -> tuple[float, float, float]:
    """X, Y, Z. Raises Broken."""
    if not isinstance(value, list) or len(value) != 3 or not all(map(is_finite_number, value)):
        raise Broken(f"{what} = {excerpt(value)}, not three finite numbers")
    x, y, z = (float(v) for v in value)
    return x, y, z
