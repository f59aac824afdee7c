"""The clauses of `talc-gateway agent-test` about values: LinuxCNC's own server passes them, wrong ones fail.

It is the server of deploy/nc/linuxcnc without LinuxCNC; the values behind it are the test's.
"""

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from gateway.commissioning.agent_test.clause import ClauseResult
from gateway.commissioning.agent_test.clauses import run_clauses
from gateway.commissioning.agent_test.connection import AgentUnderTest
from tests.benches.linuxcnc_module import linuxcnc_module

pytestmark = pytest.mark.simulated_time

KEY = b"0123456789abcdef0123456789abcdef"
READS, NAMES = "serves-clients-that-only-read", "names-the-values-that-it-does-not-have"
AnswerOf = Callable[[dict[str, Any]], Any]


def values(module: Any) -> AnswerOf:
    """The values, as docs/agent.md describes them."""

    def told(command: dict[str, Any]) -> Any:
        names = command.get("names")
        if not isinstance(names, list) or not names or not all(isinstance(name, str) for name in names):
            raise module.Refusal("names")
        return {"values": [{"motor": 41.0}.get(name) for name in names], "stale": ""}

    return told


@contextmanager
def serving(reading: tuple[str, ...], wrong: Callable[[AnswerOf, dict[str, Any]], Any] | None = None) -> Iterator[int]:
    """The port of an agent; wrong: makes its answer from the right one's function and the command."""
    module = linuxcnc_module("talc_server")
    right = values(module)
    listener = socket.create_server(("127.0.0.1", 0), backlog=128)
    port: int = listener.getsockname()[1]
    verbs: dict[str, AnswerOf] = {
        "status": lambda _: {},
        "claim": lambda _: None,
        "values": right if wrong is None else lambda command: wrong(right, command),
    }
    server = module.Server(listener, KEY, verbs, {"version": 3, "capabilities": ["values"]}, reading=reading)
    ending = threading.Event()

    def run() -> None:
        while not ending.is_set():
            server.turn()

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield port
    finally:
        ending.set()
        thread.join()
        server.close()


async def failed(port: int) -> dict[str, str]:
    """The outcomes of the clauses that failed."""
    outcomes = [o async for o in run_clauses(AgentUnderTest("127.0.0.1", port, KEY), (), (READS, NAMES))]
    assert {o.clause.name for o in outcomes} == {READS, NAMES}
    return {o.clause.name: o.came for o in outcomes if o.result is not ClauseResult.PASSED}


async def test_a_right_agent_passes() -> None:
    with serving(("values",)) as port:
        assert await failed(port) == {}


async def test_an_agent_without_clients_that_only_read_fails() -> None:
    with serving(()) as port:
        assert "another client is connected" in (await failed(port))[READS]


async def test_an_agent_that_lets_a_reader_write_fails() -> None:
    with serving(("values", "claim")) as port:
        assert await failed(port) == {READS: "claim: null"}


@pytest.mark.parametrize(
    "wrong",
    [
        lambda right, command: {**right(command), "values": [0.0, 0.0]},
        lambda right, command: {**right(command), "values": [None]},
        lambda right, command: {"values": right(command)["values"]},
        lambda right, command: right({**command, "names": command["names"] or ["motor"]}),
    ],
)
async def test_an_agent_that_invents_values_or_takes_anything_fails(
    wrong: Callable[[AnswerOf, dict[str, Any]], Any],
) -> None:
    with serving(("values",), wrong) as port:
        assert set(await failed(port)) == {NAMES}
