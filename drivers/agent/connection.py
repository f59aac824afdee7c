"""One connection to an agent: lines of JSON, each signed with the session's key. See docs/agent.md."""

import asyncio
import json
import secrets

from drivers.agent.settings import AgentSettings
from drivers.base import BadAnswer, ConnectError, NoAnswer, Refused, WrongDevice
from drivers.byte_stream import TcpStream
from drivers.section import host_and_port
from drivers.signature import is_signed, session_key, signature
from drivers.text import Text

_LONGEST_LINE = 65536
Json = None | bool | int | float | str | list["Json"] | dict[str, "Json"]


class AgentConnection:
    """Asks one question at a time. Any fault closes the connection: later answers could belong to earlier questions."""

    def __init__(self, settings: AgentSettings) -> None:
        self._settings, self._device = settings, settings.device
        self._stream = TcpStream(settings.device, settings.host, settings.port)
        self._lock = asyncio.Lock()
        self._session = b""
        self._rest = b""
        self._count = 0

    @property
    def is_open(self) -> bool:
        """Whether anything can be asked."""
        return self._stream.is_open

    async def connect(self, *, reads: bool = False) -> Json:
        """Open the connection; each side proves that it holds the key. Returns what the agent says of itself.

        reads: as a client that only reads, beside the one that writes

        Raises ConnectError, NoAnswer, Refused.
        """
        key = self._settings.key()
        async with self._lock:
            await self._stream.close()
            try:
                await self._stream.open(self._settings.timeout_s)
                self._rest, self._count, self._session = b"", 0, b""
                greeting = _parsed(await self._line(), self._device)
                if not isinstance(challenge := greeting.get("challenge"), str):
                    raise self._stranger()
                nonce = secrets.token_hex(32)
                self._session = session_key(key, challenge, nonce)
                return await self._exchange({"nonce": nonce, **({"reads": True} if reads else {})})
            except BaseException:
                await self._stream.close()
                raise

    async def close(self) -> None:
        async with self._lock:
            await self._stream.close()

    async def ask(self, do: str, **arguments: Json) -> Json:
        """The answer. Raises Refused with the agent's reason; ConnectError, NoAnswer and BadAnswer close the
        connection."""
        async with self._lock:
            if not self._stream.is_open:
                raise ConnectError(Text("not_connected"), device=self._device, hint=Text("connect_first"))
            try:
                return await self._exchange({"do": do, **arguments})
            except Refused:
                raise
            except BaseException:  # also when cancelled: the answer would arrive with no one waiting
                await self._stream.close()
                raise

    async def _exchange(self, message: dict[str, Json]) -> Json:
        text = json.dumps(message).encode()
        self._stream.write(signature(self._session, "client", self._count, text) + b" " + text + b"\n")
        line = await self._line()
        mac, _, text = line.partition(b" ")
        if self._count == 0 and line.startswith(b"{") and "error" in (refusal := _parsed(line, self._device)):
            # Before the proof nothing can be signed; a forged line here can do no more than prevent the connection.
            hint = Text("agent_compare_key")
            raise Refused(str(refusal["error"]), device=self._device, reason=_code(refusal), hint=hint)
        if not is_signed(self._session, "agent", self._count, text, mac):
            raise self._stranger()
        self._count += 1
        answer = _parsed(text, self._device)
        if "error" in answer:
            raise Refused(str(answer["error"]), device=self._device, reason=_code(answer))
        return answer.get("answer")

    async def _line(self) -> bytes:
        try:
            async with asyncio.timeout(self._settings.timeout_s):
                while b"\n" not in self._rest:
                    if len(self._rest) > _LONGEST_LINE:
                        raise self._stranger()
                    self._rest += await self._stream.read(self._settings.timeout_s)
        except TimeoutError:
            raise NoAnswer(Text("no_answer_within", timeout_s=self._settings.timeout_s), device=self._device) from None
        line, _, self._rest = self._rest.partition(b"\n")
        return line

    def _stranger(self) -> WrongDevice:
        where = host_and_port(self._settings.host, self._settings.port)
        return WrongDevice(Text("agent_stranger", where=where), device=self._device)


def _code(refusal: dict[str, Json]) -> str:
    code = refusal.get("code", "")
    return code if isinstance(code, str) else ""


def _parsed(text: bytes, device: str) -> dict[str, Json]:
    try:
        message = json.loads(text)
        json.dumps(message, ensure_ascii=False).encode()  # half a character can be neither stored nor shown
    except (ValueError, RecursionError):
        message = None
    if not isinstance(message, dict):
        raise BadAnswer(Text("agent_no_json", text=repr(text[:60])), device=device)
    return message
