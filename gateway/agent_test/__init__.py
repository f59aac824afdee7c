"""The contract of docs/agent.md as clauses, each of which tests one promise on a running agent."""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from gateway.agent_test.clause import ClauseResult, Moves
    from gateway.agent_test.clauses import CLAUSES, run_clauses
    from gateway.agent_test.connection import AgentUnderTest, Unreachable
else:
    __getattr__ = on_first_use(
        __name__,
        {
            ".clause": ("ClauseResult", "Moves"),
            ".clauses": ("CLAUSES", "run_clauses"),
            ".connection": ("AgentUnderTest", "Unreachable"),
        },
    )

__all__ = [
    "CLAUSES",
    "AgentUnderTest",
    "ClauseResult",
    "Moves",
    "Unreachable",
    "run_clauses",
]
