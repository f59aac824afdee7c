"""A client without the agent's key cannot lock out one that has it. The agent's server itself, without LinuxCNC."""

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import AsyncExitStack, ExitStack, contextmanager, suppress
from pathlib import Path

import pytest

from drivers.agent.connection import AgentConnection
from drivers.base import ConnectError
from drivers.linuxcnc.settings import LinuxCncSettings
from tests.benches.linuxcnc_bench import refusal
from tests.benches.linuxcnc_module import linuxcnc_module

pytestmark = pytest.mark.simulated_time

KEY = b"0123456789abcdef0123456789abcdef"


class Serving:
    """The server in a thread, and how to reach it."""

    def __init__(self, folder: Path) -> None:
        self.module = linuxcnc_module("talc_server")
        listener = socket.create_server(("127.0.0.1", 0), backlog=128)
        self.address = listener.getsockname()
        verbs = {"say": lambda command: command["what"], "values": lambda _: [1.0]}
        self._server = self.module.Server(listener, KEY, verbs, {}, reading=("values",))
        (folder / "talc.key").write_bytes(KEY)
        self._settings = LinuxCncSettings(key_file=folder / "talc.key", port=self.address[1], timeout_s=5.0)
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while not self._ending.is_set():
            self._server.turn()

    def gateway(self) -> AgentConnection:
        return AgentConnection(self._settings)

    def stop(self) -> None:
        self._ending.set()
        self._thread.join()
        self._server.close()


@pytest.fixture
def agent(tmp_path: Path) -> Iterator[Serving]:
    serving = Serving(tmp_path)
    try:
        yield serving
    finally:
        serving.stop()


@contextmanager
def strangers(agent: Serving, count: int) -> Iterator[list[socket.socket]]:
    """Connections that are greeted and say nothing."""
    with ExitStack() as stack:
        connections = [stack.enter_context(socket.create_connection(agent.address, timeout=60.0)) for _ in range(count)]
        yield connections


@pytest.mark.parametrize("count", [4, 16, 60])
async def test_unauthenticated_clients_that_wait_keep_no_gateway_out(count: int, agent: Serving) -> None:
    with strangers(agent, count):
        gateway = agent.gateway()
        await gateway.connect()
        assert await gateway.ask("say", what="here") == "here"
        await gateway.close()


async def test_unauthenticated_clients_that_reconnect_keep_no_gateway_out(agent: Serving) -> None:
    ending = threading.Event()

    def knock() -> None:
        while not ending.is_set():
            with suppress(OSError), socket.create_connection(agent.address, timeout=60.0) as connection:
                connection.sendall(b"slowly")
                ending.wait(0.1)

    knocking = [threading.Thread(target=knock) for _ in range(8)]
    for thread in knocking:
        thread.start()
    try:
        for _ in range(10):
            gateway = agent.gateway()
            await gateway.connect()
            assert await gateway.ask("say", what="here") == "here"
            await gateway.close()
    finally:
        ending.set()
        for thread in knocking:
            thread.join()


async def test_unauthenticated_clients_do_not_disturb_an_authenticated_one(agent: Serving) -> None:
    gateway = agent.gateway()
    await gateway.connect()
    with strangers(agent, 40):
        assert await gateway.ask("say", what="still here") == "still here"
        with refusal("occupied"):
            await agent.gateway().connect()
        assert await gateway.ask("say", what="still here") == "still here"
    await gateway.close()


def test_an_unauthenticated_client_that_is_silent_or_slow_is_disconnected(agent: Serving) -> None:
    with strangers(agent, 2) as (silent, slow):
        began = time.monotonic()
        for connection in (silent, slow):
            assert connection.recv(4096).startswith(b'{"challenge"')
        with suppress(OSError):
            while time.monotonic() - began < 10.0:
                slow.sendall(b"x")
                time.sleep(0.1)  # the pace of a slow client
        assert time.monotonic() - began < 6.0
        assert silent.recv(4096) == b""


def test_those_unauthenticated_clients_that_waited_longest_make_room_before_their_time(agent: Serving) -> None:
    began, more = time.monotonic(), 4
    with strangers(agent, agent.module.MOST_STRANGERS + more) as connections:
        for connection in connections:
            assert connection.recv(4096).startswith(b'{"challenge"')
        for connection in connections[:more]:
            assert connection.recv(4096) == b""
        assert time.monotonic() - began < agent.module.LOGIN_S


async def test_clients_that_only_read_are_served_beside_the_gateway_and_can_do_nothing_else(agent: Serving) -> None:
    async with AsyncExitStack() as stack:

        def connection() -> AgentConnection:
            one = agent.gateway()
            stack.push_async_callback(one.close)
            return one

        first, gateway = connection(), connection()
        await first.connect(reads=True)
        await gateway.connect()
        assert await first.ask("values") == [1.0]
        with refusal("command"):
            await first.ask("say", what="harm")
        with refusal("occupied"):
            await connection().connect()
        others = [connection() for _ in range(agent.module.MOST_READERS)]
        for other in others:
            await other.connect(reads=True)
            assert await other.ask("values") == [1.0]
        with pytest.raises(ConnectError):
            await first.ask("values")  # heard longest ago, it made room
        for other in others:
            assert await other.ask("values") == [1.0]
        assert await gateway.ask("say", what="still here") == "still here"


async def test_a_client_that_only_reads_needs_the_key_too(agent: Serving, tmp_path: Path) -> None:
    (tmp_path / "talc.key").write_bytes(b"x" * 32)
    with refusal("key"):
        await agent.gateway().connect(reads=True)
