"""One authenticated client on a TCP port: lines of JSON, each signed. See docs/agent.md."""

import hmac
import json
import secrets
import selectors
import socket
import stat
import time
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any

TICK_S, LOGIN_S, QUIET_S = 0.02, 2.0, 3.0
LONGEST_LINE = 4096
MOST_STRANGERS = 16
"""Connections that have not logged in; one more replaces the one that has waited longest. A holder of the key proves it
within milliseconds, so that idle connections cannot lock it out."""
MOST_READERS = 4
"""Clients that only read; one more replaces the one that was heard longest ago."""

Verb = Callable[[dict[str, Any]], Any]


class Refusal(Exception):
    """The message says what was wrong; it is the answer. code: the same for programs, whatever the words are."""

    def __init__(self, text: str, code: str = "argument") -> None:
        super().__init__(text)
        self.code = code


class Client:
    """One connection. Its first line proves that it holds the key, later ones are commands."""

    def __init__(self, line: socket.socket) -> None:
        self.line, self.challenge, self.heard_s = line, secrets.token_hex(32), time.monotonic()
        self.session: bytes | None = None
        self.reads = False
        """Whether it only reads, beside the gateway that writes."""
        self.rest, self.heard, self.said = b"", 0, 0


class Server:
    """Serves while `turn` is called. reading: the verbs of a client that only reads."""

    def __init__(
        self,
        listener: socket.socket,
        key: bytes,
        verbs: Mapping[str, Verb],
        greeting: Mapping[str, Any],
        reading: Collection[str] = (),
    ) -> None:
        self._key, self._verbs, self._listener, self._reading = key, verbs, listener, reading
        self._greeting = {"commands": sorted(verbs), **greeting}
        self._clients: list[Client] = []
        self._selector = selectors.DefaultSelector()
        listener.setblocking(False)
        self._selector.register(listener, selectors.EVENT_READ, None)

    def turn(self) -> None:
        """Wait for a line for one tick, answer what came."""
        for key, _ in self._selector.select(TICK_S):
            if key.data is None:
                self._welcome()
            elif key.data in self._clients:  # not dropped in this turn
                self._listen(key.data)
        for client in [c for c in self._clients if c.session is None and time.monotonic() - c.heard_s > LOGIN_S]:
            self._drop(client)

    def close(self) -> None:
        """Close the port and every connection."""
        for client in list(self._clients):
            self._drop(client)
        self._selector.close()
        self._listener.close()

    def _welcome(self) -> None:
        """Accept all waiting connections, so that no queue forms; at most as many as there are places."""
        for _ in range(MOST_STRANGERS):
            try:
                line, _ = self._listener.accept()
            except OSError:
                return
            strangers = [c for c in self._clients if c.session is None]
            if len(strangers) >= MOST_STRANGERS:
                self._drop(strangers[0])
            self._admit(line)

    def _admit(self, line: socket.socket) -> None:
        line.setblocking(False)
        client = Client(line)
        self._clients.append(client)
        self._selector.register(line, selectors.EVENT_READ, client)
        self._say(client, {"challenge": client.challenge})

    def _listen(self, client: Client) -> None:
        try:
            heard = client.line.recv(LONGEST_LINE)
        except BlockingIOError:
            return
        except OSError:
            heard = b""
        *lines, client.rest = (client.rest + heard).split(b"\n")
        if not heard or len(client.rest) > LONGEST_LINE:
            self._drop(client)
            return
        for line in lines:
            if client in self._clients:
                self._answer(client, line)

    def _answer(self, client: Client, line: bytes) -> None:
        mac, _, text = line.partition(b" ")
        if client.session is not None:
            if not _fits(client.session, "client", client.heard, text, mac):
                self._drop(client)  # not from whoever logged in: nothing it says gets an answer
                return
            client.heard, client.heard_s = client.heard + 1, time.monotonic()
        try:
            command = json.loads(text)
            if not isinstance(command, dict):
                raise Refusal("expected an object")
            if client.session is None:
                self._login(client, command, mac, text)
                answer: Any = self._greeting
            else:
                answer = self._obey(client, command)
            self._say(client, {"answer": answer})
        except (Refusal, ValueError, RecursionError) as error:
            self._say(client, {"error": str(error), "code": getattr(error, "code", "argument")})
            if client.session is None:
                self._drop(client)

    def _obey(self, client: Client, command: dict[str, Any]) -> Any:
        wanted, known = str(command.get("do")), self._reading if client.reads else self._verbs
        if wanted not in known:
            only = " of a client that only reads" if client.reads else ""
            raise Refusal(f"do = {command.get('do')!r}: expected one of {', '.join(known)}{only}", "command")
        return self._verbs[wanted](command)

    def _login(self, client: Client, command: dict[str, Any], mac: bytes, text: bytes) -> None:
        """The session's key is derived from the shared key and a number from each side: nothing can be replayed."""
        session = hmac.digest(self._key, f"{client.challenge} {command.get('nonce')}".encode(), "sha256")
        if not _fits(session, "client", 0, text, mac):
            raise Refusal("the proof does not fit: is it the same key on both sides?", "key")
        client.reads = bool(self._reading) and command.get("reads") is True
        if client.reads:
            self._make_room()
        else:
            self._make_way()
        client.session, client.heard, client.heard_s = session, 1, time.monotonic()

    def _make_room(self) -> None:
        readers = [c for c in self._clients if c.session is not None and c.reads]
        if len(readers) >= MOST_READERS:
            self._drop(min(readers, key=lambda c: c.heard_s))

    def _make_way(self) -> None:
        """For the only client that may write."""
        for other in [c for c in self._clients if c.session is not None and not c.reads]:
            if time.monotonic() - other.heard_s < QUIET_S:
                raise Refusal("another client is connected", "occupied")
            self._drop(other)  # perhaps its computer lost power and connects again here

    def _say(self, client: Client, message: dict[str, Any]) -> None:
        text = json.dumps(message).encode()
        if client.session is not None:
            text = _mac(client.session, "agent", client.said, text) + b" " + text
            client.said += 1
        try:
            client.line.sendall(text + b"\n")
        except OSError:  # gone, or does not read
            self._drop(client)

    def _drop(self, client: Client) -> None:
        if client in self._clients:
            self._clients.remove(client)
            self._selector.unregister(client.line)
            client.line.close()


def _mac(session: bytes, who: str, count: int, text: bytes) -> bytes:
    return hmac.new(session, f"{who} {count} ".encode() + text, "sha256").hexdigest().encode()


def _fits(session: bytes, who: str, count: int, text: bytes, mac: bytes) -> bool:
    return hmac.compare_digest(_mac(session, who, count, text), mac)


def read_key(path: Path) -> bytes:
    """Ends with a message when others may read it or it is too short."""
    if not path.exists():
        raise SystemExit(f"{path}: no such file; make one: (umask 077; openssl rand -hex 32 > {path})")
    if path.stat().st_mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise SystemExit(f"{path}: others may read the key: chmod 600")
    key = path.read_bytes().strip()
    if len(key) < 32:
        raise SystemExit(f"{path}: the key has {len(key)} characters: expected at least 32")
    return key
