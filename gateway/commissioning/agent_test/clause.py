"""A clause and its result."""

from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum

from drivers.agent.greeting import Capability, Greeting
from gateway.commissioning.agent_test.connection import AgentUnderTest


class ClauseResult(StrEnum):
    """The result of one clause."""

    PASSED = "passed"
    FAILED = "failed"
    NOT_OFFERED = "not offered"
    """The agent does not have the capability."""
    NOT_RUN = "not run"
    """It would move the machine, which was not allowed."""


class Moves(StrEnum):
    """What a clause moves."""

    OFFSETS = "offsets"
    """Offsets of at most 5 µm."""
    CYCLE = "cycle"
    """The machine, in a probing cycle."""


@dataclass(frozen=True, slots=True)
class Trial:
    """What a clause needs to know."""

    target: AgentUnderTest
    greeting: Mapping[str, object]
    told: Greeting
    """The same, as the gateway understands it."""
    cycle_limit_s: float


@dataclass(frozen=True, slots=True)
class Clause:
    """One promise of the contract."""

    name: str
    expected: str
    """What the agent must do, in one sentence."""
    needs: frozenset[Capability]
    """Any of these; empty: every agent has to."""
    also: frozenset[Capability]
    """And any of these; empty: no more."""
    moves: frozenset[Moves]
    run: Callable[[Trial], Awaitable[None]]

    def offered(self, can: frozenset[Capability]) -> bool:
        """Whether an agent with these capabilities has to keep it."""
        return all(can & wanted for wanted in (self.needs, self.also) if wanted)


@dataclass(frozen=True, slots=True)
class ClauseOutcome:
    """The outcome of a clause."""

    clause: Clause
    result: ClauseResult
    came: str = ""
    """If it failed: what came instead of what was expected."""


class Clauses(list[Clause]):
    """Clauses, in the order in which they are tried."""

    def add(
        self,
        needs: frozenset[Capability] = frozenset(),
        *moves: Moves,
        also: frozenset[Capability] = frozenset(),
    ) -> Callable[[Callable[[Trial], Awaitable[None]]], Callable[[Trial], Awaitable[None]]]:
        """A decorator: the function's name is the clause's, its docstring what is expected."""

        def added(run: Callable[[Trial], Awaitable[None]]) -> Callable[[Trial], Awaitable[None]]:
            expected = " ".join((run.__doc__ or "").split())
            self.append(Clause(run.__name__.replace("_", "-"), expected, needs, also, frozenset(moves), run))
            return run

        return added
