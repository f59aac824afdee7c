"""What arrives from an agent: a signed answer is returned unchanged, anything else closes the connection."""

import asyncio
import json
import math
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from drivers.agent.connection import AgentConnection
from drivers.agent.control import AgentControl
from drivers.base import BadAnswer, ConnectError, DriverError, NoAnswer, Refused, WrongDevice
from drivers.nc import WatchdogTerms
from tests.benches.fake_agent import CHALLENGE, Agent, agent_and_connection, agent_and_driver, serving

pytestmark = pytest.mark.simulated_time

JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**60), 2**60) | st.floats(allow_nan=False) | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)
NOISE = st.one_of(
    st.binary(max_size=80),
    JSON.map(lambda value: json.dumps(value).encode()),
    st.sampled_from([b"", b" ", b"{", b"{}", b'{"error": "x"}', b'{"challenge": 3}', b"\xff\xfe", b"0" * 64 + b" {}"]),
    st.sampled_from([b"[" * 40_000, b"1" * 6000]),
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("key")


def test_signed_answers_are_given_as_they_are_and_refusals_with_their_reason(folder: Path) -> None:
    async def asked(answers: list[object], reasons: list[str]) -> None:
        async with agent_and_connection(folder) as (agent, connection):
            await connection.connect()
            for answer in answers:
                agent.says = [agent.signed(json.dumps({"answer": answer}).encode())]
                assert await connection.ask("state") == answer
            for reason in reasons:
                agent.says = [agent.signed(json.dumps({"error": reason}).encode())]
                with pytest.raises(Refused) as caught:
                    await connection.ask("mdi")
                assert caught.value.what == reason
            assert await connection.ask("state", axis=1) == {"do": "state", "axis": 1}, "a refusal changes nothing"

    with asyncio.Runner() as runner:

        @settings(max_examples=60)
        @given(st.lists(JSON, max_size=3), st.lists(st.text(max_size=20), max_size=2))
        def any_answer(answers: list[object], reasons: list[str]) -> None:
            runner.run(asked(answers, reasons))

        any_answer()


def test_whatever_is_not_signed_for_this_question_closes_the_connection(folder: Path) -> None:
    """Then nothing more is asked on it, and a new connection is right from the first answer on."""

    async def asked(said: bytes, before: int) -> None:
        async with agent_and_connection(folder) as (agent, connection):
            await connection.connect()
            for number in range(before):
                assert await connection.ask("count", number=number) == {"do": "count", "number": number}
            agent.says = [said + b"\n"]
            with pytest.raises((WrongDevice, BadAnswer)):
                await connection.ask("state")
            with pytest.raises(ConnectError, match="connect first"):
                await connection.ask("state")
            agent.says = []
            await connection.connect()
            assert await connection.ask("again") == {"do": "again"}

    with asyncio.Runner() as runner:

        @settings(max_examples=80)
        @given(NOISE, st.integers(0, 2))
        @example(b'{"error": "a refusal is signed, too"}', 0)
        def anything(said: bytes, before: int) -> None:
            runner.run(asked(said, before))

        anything()


def test_whatever_greets_or_proves_wrongly_is_refused(folder: Path) -> None:
    async def connected(greeting: bytes, proof: bytes | None) -> None:
        async with agent_and_connection(folder) as (agent, connection):
            usual, agent.greeting = agent.greeting, greeting
            agent.says = [proof + b"\n"] if proof is not None else []
            with pytest.raises((WrongDevice, BadAnswer, Refused)):
                await connection.connect()
            with pytest.raises(ConnectError, match="connect first"):
                await connection.ask("state")
            agent.greeting, agent.says = usual, []
            await connection.connect()
            assert await connection.ask("again") == {"do": "again"}

    with asyncio.Runner() as runner:

        @settings(max_examples=60)
        @given(NOISE, st.booleans())
        def anything(said: bytes, greets: bool) -> None:
            if greets:
                runner.run(connected(said, None))
            else:
                runner.run(connected(json.dumps({"challenge": CHALLENGE}).encode(), said))

        anything()


@pytest.mark.parametrize(
    "spoilt",
    [
        pytest.param(lambda line: line[:70].swapcase() + line[70:], id="another signature"),
        pytest.param(lambda line: line.replace(b"42", b"43"), id="another number"),
        pytest.param(lambda line: line[:-3] + b"\n", id="cut"),
        pytest.param(lambda line: line[1:], id="without its first byte"),
        pytest.param(lambda line: b"\n" + line, id="an empty line before"),
    ],
)
async def test_signed_answer_that_was_changed_closes_the_connection(spoilt: Any, tmp_path: Path) -> None:
    async with agent_and_connection(tmp_path) as (agent, connection):
        await connection.connect()
        agent.says = [spoilt(agent.signed(b'{"answer": 42}'))]
        with pytest.raises(WrongDevice, match="is not the agent with this key"):
            await connection.ask("state")
        await connection.connect()
        assert await connection.ask("again") == {"do": "again"}


async def test_answer_to_another_question_is_not_taken(tmp_path: Path) -> None:
    """Repeated, or signed for a later one."""
    async with agent_and_connection(tmp_path) as (agent, connection):
        for ahead in (-1, 1):
            await connection.connect()
            agent.says = [agent.signed(b'{"answer": 42}', ahead=ahead)]
            with pytest.raises(WrongDevice):
                await connection.ask("state")


@pytest.mark.parametrize(
    "said", [rb'{"answer": {"tool": "\ud800"}}', rb'{"error": "\udfff"}', rb'{"answer": {"\ud800": 1}}']
)
async def test_half_a_character_which_nothing_can_store_is_a_bad_answer(said: bytes, tmp_path: Path) -> None:
    async with agent_and_connection(tmp_path) as (agent, connection):
        await connection.connect()
        agent.says = [agent.signed(said)]
        with pytest.raises(BadAnswer, match="expected a JSON object"):
            await connection.ask("status")


async def test_what_does_not_come_in_time_leaves_the_connection_open(tmp_path: Path) -> None:
    """Neither a watchdog that does not start nor offsets that do not come into force looks like a lost connection."""
    async with agent_and_driver(tmp_path) as (agent, nc):
        agent.answers |= {"heartbeat": False}
        agent.thinks_s = 0.3
        await nc.claim(7, WatchdogTerms(5.0, 1.0))
        assert not await nc.heartbeat(7)
        await nc.write_compensation((4.0, 0.0, 0.0))
        assert await nc.read_compensation() == (0.0, 0.0, 0.0)


async def test_line_without_an_end_or_too_long_is_an_invalid_answer(tmp_path: Path) -> None:
    async with agent_and_connection(tmp_path, timeout_s=0.2) as (agent, connection):
        await connection.connect()
        agent.says = [agent.signed(b'{"answer": 42}')[:-1]]
        with pytest.raises(NoAnswer):
            await connection.ask("state")
        await connection.connect()
        agent.says = [b"x" * 200_000]
        with pytest.raises(DriverError, match="is not the agent with this key"):
            await connection.ask("state")


ASKED: dict[str, Callable[[AgentControl], Awaitable[object]]] = {
    "status": AgentControl.snapshot,
    "read": AgentControl.read_compensation,
    "probing": lambda nc: nc.probing_status(17),
}
NO_NUMBERS = {"too long": 10**400, "below too long": -(10**400), "truth": True, "text": "1", "nothing": None,
              "NaN": math.nan, "infinite": math.inf}  # fmt: skip


@pytest.mark.parametrize("number", NO_NUMBERS.values(), ids=NO_NUMBERS)
@pytest.mark.parametrize("question", ASKED)
async def test_what_is_not_a_number_is_a_bad_answer(question: str, number: object, tmp_path: Path) -> None:
    async with agent_and_driver(tmp_path) as (agent, nc):
        agent.answers = {
            "status": {"positions": {**dict.fromkeys("XYZAC", 0.0), "Z": number}, "states": {}},
            "read": [0.0, number, 0.0],
            "probing": {"state": "done", "centres": [[0.0] * 3] * 6, "spread": number},
        }
        with pytest.raises(BadAnswer, match="expected a finite number"):
            await ASKED[question](nc)


async def test_an_agent_with_another_key_is_not_trusted(tmp_path: Path) -> None:
    """It greets, answers and signs as ours does, and gets nothing from us but the proof."""
    impostor = Agent(b"fedcba9876543210fedcba9876543210")
    async with serving(impostor, tmp_path) as settings:
        connection = AgentConnection(settings)
        with pytest.raises(WrongDevice, match="is not the agent with this key"):
            await connection.connect()
        with pytest.raises(ConnectError, match="connect first"):
            await connection.ask("status")
        assert [sorted(message) for message in impostor.heard] == [["nonce"]]
