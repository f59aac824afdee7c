"""All clauses, and running them one after the other."""

from collections.abc import AsyncIterator, Collection
from typing import Any

from drivers.agent.greeting import Greeting, greeting_of
from drivers.base import DriverError
from gateway.commissioning.agent_test.clause import Clause, ClauseOutcome, ClauseResult, Moves, Trial
from gateway.commissioning.agent_test.connection import AgentUnderTest, Broken, Told, Unreachable, connected
from gateway.commissioning.agent_test.cycle import CYCLE
from gateway.commissioning.agent_test.follow import FOLLOW
from gateway.commissioning.agent_test.login import LOGIN
from gateway.commissioning.agent_test.offsets import OFFSET
from gateway.commissioning.agent_test.values import VALUES

CLAUSES: tuple[Clause, ...] = (*LOGIN, *VALUES, *OFFSET, *FOLLOW, *CYCLE)


async def run_clauses(
    target: AgentUnderTest,
    allowed: Collection[Moves] = (),
    only: Collection[str] = (),
    cycle_limit_s: float = 900.0,
) -> AsyncIterator[ClauseOutcome]:
    """Each clause's outcome as it comes.

    allowed: what may move; nothing else does. only: names of clauses; empty: all.

    Raises Unreachable when there is no agent that lets us in.
    """
    greeting = await _greeting(target)
    try:
        told = greeting_of(greeting, "")
    except DriverError:
        told = Greeting()  # the clause on the greeting says what is wrong with it
    trial = Trial(target, greeting, told, cycle_limit_s)
    for clause in CLAUSES:
        if only and clause.name not in only:
            continue
        if not clause.offered(told.can):
            yield ClauseOutcome(clause, ClauseResult.NOT_OFFERED)
        elif not clause.moves <= frozenset(allowed):
            yield ClauseOutcome(clause, ClauseResult.NOT_RUN)
        else:
            yield await _tried(clause, trial)


async def _greeting(target: AgentUnderTest) -> dict[str, Any]:
    try:
        async with connected(target) as agent:
            greeting = await agent.login()
    except Told as refusal:
        raise Unreachable(f"the agent refuses the login: {refusal}") from None
    except Broken as broken:
        raise Unreachable(f"the login ended with {broken}") from None
    return greeting if isinstance(greeting, dict) else {}


async def _tried(clause: Clause, trial: Trial) -> ClauseOutcome:
    try:
        await clause.run(trial)
    except (Broken, Unreachable) as broken:
        return ClauseOutcome(clause, ClauseResult.FAILED, str(broken))
    except Told as refusal:
        return ClauseOutcome(clause, ClauseResult.FAILED, f"the error {refusal}")
    except (KeyError, TypeError, ValueError, AttributeError, ArithmeticError) as error:
        return ClauseOutcome(
            clause, ClauseResult.FAILED, f"an answer of another form ({type(error).__name__}: {error})"
        )
    return ClauseOutcome(clause, ClauseResult.PASSED)
