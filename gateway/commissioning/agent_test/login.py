"""Clauses of login and connection: who may log in, what ends the connection, what is answered."""

import asyncio
import json
from contextlib import AsyncExitStack, suppress

from drivers.agent.greeting import PROTOCOL_VERSION, Capability, greeting_of
from drivers.base import DriverError
from drivers.nc import AXES, FARTHEST_MM, LINEAR_AXES, OperatingMode, ProgramState
from drivers.signature import SHORTEST_KEY
from gateway.commissioning.agent_test.clause import Clauses, Trial
from gateway.commissioning.agent_test.connection import (
    BareConnection,
    Broken,
    Told,
    connected,
    excerpt,
    is_finite_number,
    logged_in,
)

LOGIN = Clauses()
OFFSET_CAPABILITIES = frozenset({Capability.SHIFT, Capability.SLOPES, Capability.ERRORS})
_STRANGERS = 20
_LOGIN_S = 10.0
_SILENT_S = 2.5
"""Less than the 3 s after which a client that says nothing may be replaced."""


async def _refused(agent: BareConnection, what: str) -> None:
    try:
        answer = await agent.login()
    except Told:
        return
    raise Broken(f"{what}: {excerpt(answer)}")


@LOGIN.add()
async def greets_with_a_challenge(trial: Trial) -> None:
    """A first line {"challenge": ...} of 32 characters or more, another one for each connection."""
    async with connected(trial.target) as first, connected(trial.target) as second:
        if len(first.challenge) < SHORTEST_KEY:
            raise Broken(f"the challenge {excerpt(first.challenge)}")
        if first.challenge == second.challenge:
            raise Broken("the same challenge twice")


@LOGIN.add()
async def refuses_another_key(trial: Trial) -> None:
    """A login with another key is refused, and the connection ends."""
    async with connected(trial.target) as agent:
        await agent.say(agent.login_line(trial.target.key[::-1] + b"x"))
        await agent.check_ends()


@LOGIN.add()
async def refuses_commands_before_the_login(trial: Trial) -> None:
    """A command as the first line is refused, and the connection ends."""
    async with connected(trial.target) as agent:
        await agent.say(b"0" * 64 + b' {"do": "status"}\n')
        await agent.check_ends()


@LOGIN.add()
async def refuses_a_login_that_was_heard_before(trial: Trial) -> None:
    """The first line of an earlier connection is refused on a new one."""
    async with logged_in(trial.target) as agent:
        heard = agent.first
    async with connected(trial.target) as agent:
        await agent.say(heard)
        await agent.check_ends()


@LOGIN.add()
async def ends_at_a_wrong_signature(trial: Trial) -> None:
    """After the login, a line with a wrong mac ends the connection without an answer."""
    async with logged_in(trial.target) as agent:
        right = agent.signed(b'{"do": "status"}')
        await agent.say((b"1" if right[:1] == b"0" else b"0") + right[1:])
        await agent.check_ends()


@LOGIN.add()
async def ends_at_an_unsigned_line(trial: Trial) -> None:
    """After the login, a line without a mac ends the connection without an answer."""
    async with logged_in(trial.target) as agent:
        await agent.say(b'{"do": "status"}\n')
        await agent.check_ends()


@LOGIN.add()
async def ends_at_a_repeated_line(trial: Trial) -> None:
    """A repeated line ends the connection, even though it was valid the first time."""
    async with logged_in(trial.target) as agent:
        again = agent.signed(b'{"do": "status"}')
        await agent.ask_text('{"do": "status"}')
        await agent.say(again)
        await agent.check_ends()


@LOGIN.add()
async def ends_at_an_endless_line(trial: Trial) -> None:
    """A line of 70,000 bytes without an end ends the connection."""
    async with logged_in(trial.target) as agent:
        with suppress(Broken):  # it may have ended it already
            await agent.say(b"x" * 70_000)
        await agent.check_ends()


@LOGIN.add()
async def signs_its_errors_and_stays(trial: Trial) -> None:
    """A signed line that is not JSON, not an object or unknown gets a signed error, and the connection continues."""
    async with logged_in(trial.target) as agent:
        for text in ('{"do": "shell"}', "{}", "[1]", "7", "null", "{", "", "[" * 2000, '{"do": ["status"]}'):
            try:
                answer = await agent.ask_text(text)
            except Told:
                continue
            except Broken as broken:
                raise Broken(f"to {excerpt(text.encode())}: {broken}") from None
            raise Broken(f"to {excerpt(text.encode())} the answer {excerpt(answer)}")
        await agent.ask("status")


@LOGIN.add()
async def takes_lines_in_pieces_and_several_at_once(trial: Trial) -> None:
    """A line may come in two pieces, and two lines at once; each is answered in order."""
    async with logged_in(trial.target) as agent:
        text = b'{"do": "status"}'
        whole = agent.signed(text)
        await agent.say(whole[:30])
        await asyncio.sleep(0.1)
        await agent.say(whole[30:])
        await agent.hear_answer()
        await agent.say(agent.signed(text) + agent.signed_later(text))
        await agent.hear_answer()
        await agent.hear_answer()


@LOGIN.add()
async def serves_one_client(trial: Trial) -> None:
    """While a client is connected and asks, another login with the key is refused."""
    async with logged_in(trial.target) as first:
        await first.ask("status")
        async with connected(trial.target) as second:
            await _refused(second, "another client is let in")
        await first.ask("status")


@LOGIN.add()
async def replaces_a_silent_client(trial: Trial) -> None:
    """A client that was silent for more than 3 s is replaced by one with the key."""
    async with logged_in(trial.target), AsyncExitStack() as stack:
        await asyncio.sleep(_SILENT_S)
        await stack.enter_async_context(logged_in(trial.target))


@LOGIN.add()
async def lets_the_key_in_past_strangers(trial: Trial) -> None:
    """Twenty connections that do not log in do not lock out a client with the key."""
    async with AsyncExitStack() as stack:
        for _ in range(_STRANGERS):
            with suppress(Broken):  # it may close some of them
                await stack.enter_async_context(connected(trial.target))
        await stack.enter_async_context(logged_in(trial.target))


@LOGIN.add()
async def ends_connections_that_do_not_log_in(trial: Trial) -> None:
    """A connection that sends nothing ends (2 s; tried: 10 s)."""
    async with connected(trial.target) as agent:
        await agent.check_ends(_LOGIN_S)


@LOGIN.add()
async def greeting_is_complete(trial: Trial) -> None:
    """The greeting contains version 3, capabilities, and what docs/agent.md requires for each of them."""
    greeting = trial.greeting
    if greeting.get("version") != PROTOCOL_VERSION:
        raise Broken(f"version = {excerpt(greeting.get('version'))}")
    if "capabilities" not in greeting:
        raise Broken("no capabilities")
    try:
        greeting_of(json.loads(json.dumps(greeting)), "")
    except DriverError as error:
        raise Broken(error.what) from None
    bound = greeting.get("bound_um")
    if trial.told.can & OFFSET_CAPABILITIES and not (is_finite_number(bound) and float(str(bound)) > 0):
        raise Broken(f"bound_um = {excerpt(bound)}")


@LOGIN.add()
async def status_is_complete(trial: Trial) -> None:
    """`status` contains finite positions of X, Y, Z, A, C, none of X, Y, Z beyond 100 m, finite states, and each key of
    docs/agent.md with its type."""
    async with logged_in(trial.target) as agent:
        status = await agent.ask("status")
    if not isinstance(status, dict):
        raise Broken(excerpt(status))
    positions, states = status.get("positions"), status.get("states")
    if not isinstance(positions, dict) or not all(is_finite_number(positions.get(a)) for a in AXES):
        raise Broken(f"positions = {excerpt(positions)}")
    if any(abs(positions[axis]) > FARTHEST_MM for axis in LINEAR_AXES):
        raise Broken(f"positions = {excerpt(positions)}: beyond 100 m")
    if not isinstance(states, dict) or not all(map(is_finite_number, states.values())):
        raise Broken(f"states = {excerpt(states)}")
    for name in ("estop", "on", "homed", "probe", "probing"):
        if not isinstance(status.get(name), bool):
            raise Broken(f"{name} = {excerpt(status.get(name))}, neither true nor false")
    words: dict[str, type[OperatingMode] | type[ProgramState]] = {"mode": OperatingMode, "program": ProgramState}
    for name, kind in words.items():
        if status.get(name) not in [member.value for member in kind]:
            raise Broken(f"{name} = {excerpt(status.get(name))}")
    if not isinstance(status.get("cannot_probe", ""), str):
        raise Broken(f"cannot_probe = {excerpt(status['cannot_probe'])}")
