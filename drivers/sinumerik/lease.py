"""Claim and heartbeat of a SINUMERIK: docs/nc.md, Claim and watchdog."""

import asyncio
import math
from typing import Final

from drivers.base import Refused
from drivers.nc import check_number
from drivers.opcua.session import OpcUaSession
from drivers.sinumerik.numbers import code_of, finite_numbers
from drivers.sinumerik.settings import SinumerikSettings
from drivers.text import Text

ALIVE: Final = 1
"""State of the control's watchdog while it receives the gateway's heartbeat."""
_POLL_S = 0.02
"""Between two looks at a beat, which passes through the control's program in each interpolation cycle."""
_POLLS = 12
"""How often it is looked at."""

_SAME: Final = 1e-6


class SinumerikLease:
    """Errors like Sinumerik's.

    Attributes
    ----------
    echo: node of the beat that has passed through the control's whole program. R-parameters outlast power off and the
        end of the program; only a program that runs gives this one a new number
    """

    def __init__(self, session: OpcUaSession, settings: SinumerikSettings) -> None:
        numbers, r = settings.lease, settings.r
        self._session, self._device = session, settings.device
        self._owner, self._beat, self._state = r(numbers.owner), r(numbers.beat), r(numbers.state)
        self._age = r(numbers.age)
        self.echo = r(numbers.echo)
        self._terms: dict[str, float] = {}

    @property
    def nodes(self) -> tuple[str, ...]:
        """What it reads, and what the control's program needs."""
        return self._owner, self._beat, self._state, self._age, self.echo

    async def holder(self) -> float:
        """Number of the gateway whose heartbeat is alive; 0: none."""
        owner, _, state, *_ = await self._look()
        return owner if state == ALIVE else 0.0

    async def claim(self, owner: int, terms: dict[str, float], predecessor: int | None) -> None:
        """terms: what the watchdog does on silence, by node, written before the owner. Raises ValueError for an owner
        outside 1 .. 2**31 - 1."""
        check_number(owner, "owner")
        self._terms = {}
        holder, beat, state, echo, _ = await self._look()
        if holder not in (0, owner, predecessor) and state == ALIVE:
            raise self._anothers(holder)
        await self._session.write(terms)
        self._terms = dict(terms)
        await self._session.write({self._owner: float(owner)})
        await self._session.write({self._beat: next_beat(beat, echo)})

    async def heartbeat(self, owner: int) -> bool:
        """Whether the watchdog was active before this beat, with the terms of the claim, and this beat has passed
        through its program."""
        check_number(owner, "owner")
        holder, beat, state, echo, kept = await self._look()
        if holder != owner:
            raise self._anothers(holder)
        passed = await self._passes(next_beat(beat, echo))
        return state == ALIVE and echo == beat and passed and kept

    async def release(self, owner: int) -> None:
        check_number(owner, "owner")
        holder, *_ = await self._look()
        if holder == owner:
            await self._session.write({self._owner: 0.0})

    async def _passes(self, beat: float) -> bool:
        await self._session.write({self._beat: beat})
        for _ in range(_POLLS):
            [echo] = finite_numbers((self.echo,), await self._session.read((self.echo,)), self._device)
            if echo == beat:
                return True
            await asyncio.sleep(_POLL_S)
        return False

    async def _look(self) -> tuple[float, float, float, float, bool]:
        """Owner, beat, state and echo; whether the terms are still those of this gateway's claim."""
        paths = self._owner, self._beat, self._state, self.echo, *self._terms
        owner, beat, state, echo, *found = finite_numbers(paths, await self._session.read(paths), self._device)
        wanted = self._terms.values()
        kept = all(math.isclose(a, b, rel_tol=_SAME) for a, b in zip(found, wanted, strict=True))
        return owner, beat, state, echo, kept

    def _anothers(self, holder: float) -> Refused:
        return Refused(
            Text("nc_other_gateway", holder=holder),
            device=self._device,
            hint=Text("stop_other_gateway"),
        )


def next_beat(beat: float, echo: float) -> float:
    """A number that differs from the last beat, because the watchdog detects changes, and from the one that it has
    copied: only a program that runs can make them equal."""
    following = ((code_of(beat) + more) % 1_000_000 for more in (1, 2))
    return float(next(number for number in following if number != code_of(echo)))
