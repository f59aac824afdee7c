"""The outcome of each clause, on a terminal."""

import asyncio
import textwrap
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

import click

from drivers.bounded_file import bytes_of
from drivers.problems import suggestion
from drivers.section import host_name
from gateway.commissioning.agent_test.clause import ClauseResult, Moves
from gateway.commissioning.agent_test.clauses import CLAUSES, run_clauses
from gateway.commissioning.agent_test.connection import AgentUnderTest, Unreachable
from gateway.runtime.terminal import printable


def try_agent(
    host: str, port: int, key_file: Path, timeout_s: float, *, moves: Mapping[str, bool], only: tuple[str, ...],
    cycle_limit_s: float,
) -> bool | None:  # fmt: skip
    """Print each clause with its result; True if none fails, None if there is no agent. Raises click.UsageError.

    moves: whether `offsets` and `cycle` are allowed
    """
    names = [clause.name for clause in CLAUSES]
    if unknown := sorted({*only} - {*names}):
        raise click.UsageError(f"--only {unknown[0]}: {suggestion(unknown[0], names)}")
    try:
        host_name(host)
    except ValueError as error:
        raise click.BadParameter(str(error), param_hint="HOST") from None
    allowed = frozenset(Moves(name) for name, wanted in moves.items() if wanted)
    target = AgentUnderTest(host, port, bytes_of(key_file).strip(), timeout_s)
    try:
        return asyncio.run(tell(target, allowed, only, cycle_limit_s))
    except Unreachable as error:
        click.echo(f"nothing was tried: {printable(str(error))}", err=True)
        return None


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
