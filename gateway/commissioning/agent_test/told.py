"""The outcome of each clause, on a terminal."""

import textwrap
from collections import Counter

import click

from gateway.commissioning.agent_test.clause import ClauseResult, Moves
from gateway.commissioning.agent_test.clauses import CLAUSES, run_clauses
from gateway.commissioning.agent_test.connection import AgentUnderTest
from gateway.runtime.terminal import printable


async def tell(target: AgentUnderTest, allowed: frozenset[Moves], only: tuple[str, ...], cycle_limit_s: float) -> bool:
    """Print each clause with its result; True if none fails. Raises Unreachable."""
    width = max(len(clause.name) for clause in CLAUSES)
    counts: Counter[ClauseResult] = Counter()
    async for outcome in run_clauses(target, allowed, only, cycle_limit_s):
        counts[outcome.result] += 1
        click.echo(f"{outcome.clause.name:{width}}  {outcome.result.value}")
        if outcome.result is ClauseResult.FAILED:
            for head, text in (("expected", outcome.clause.expected), ("came", outcome.came)):
                first, next_ = f"    {head}: ", "      "
                click.echo(textwrap.fill(printable(text), 110, initial_indent=first, subsequent_indent=next_))
    click.echo(", ".join(f"{counts[result]} {result.value}" for result in ClauseResult if counts[result]))
    return not counts[ClauseResult.FAILED]
