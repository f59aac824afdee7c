"""`talc-gateway agent-test`: tries the contract of docs/agent.md on a running agent, clause by clause."""

import sys
from pathlib import Path

import click

from drivers.agent.settings import AGENT_PORT
from gateway.cli.arguments import FiniteNumber, OldFile
from gateway.cli.exits import EXIT_DIFFERENT, EXIT_WORLD


@click.command("agent-test")
@click.argument("host")
@click.option("--port", type=click.IntRange(1, 65535), default=AGENT_PORT, show_default=True, help="[nc] port")
@click.option("--key-file", type=OldFile, required=True, help="[nc] key_file: file with the agent's key.")
@click.option("--timeout", type=FiniteNumber(min=0.1), default=2.0, show_default=True,
              help="[nc] timeout_s: how long an answer may take, and an offset until it is in force.")  # fmt: skip
@click.option("--offsets", is_flag=True,
              help="Also write offsets: the tool MOVES, 5 µm at most; a wrong agent may reach its bound.")  # fmt: skip
@click.option("--cycle", is_flag=True, help="Also run probing cycles: the machine MOVES and touches the sphere.")
@click.option("--cycle-limit", type=FiniteNumber(min=1), default=900.0, show_default=True,
              help="Seconds within which a cycle has ended.")  # fmt: skip
@click.option("--only", multiple=True, metavar="CLAUSE", help="Try only this clause; may be given several times.")
def agent_test(
    host: str,
    port: int,
    key_file: Path,
    timeout: float,
    offsets: bool,
    cycle: bool,
    cycle_limit: float,
    only: tuple[str, ...],
) -> None:
    """Try the contract of docs/agent.md on the agent at HOST, clause by clause.

    \b
    For authors of agents. Each clause is passed, failed (with what was expected and what came), not offered by this
    agent, or not run. Nothing moves without --offsets or --cycle. Stop the gateway before: an agent serves one client.
    Exit codes: 0 every clause that was tried holds; 1 one does not; 3 there is no agent, or the login fails.
    """
    from gateway.commissioning.agent_test.told import try_agent

    moves = {"offsets": offsets, "cycle": cycle}
    held = try_agent(host, port, key_file, timeout, moves=moves, only=only, cycle_limit_s=cycle_limit)
    sys.exit(EXIT_WORLD if held is None else 0 if held else EXIT_DIFFERENT)
