"""Slopes through an agent that adds K0 + tanβ (P - P0) in each cycle of its control."""

import math
from collections.abc import Awaitable, Callable, Sequence

from drivers.agent.connection import AgentConnection, Json
from drivers.agent.greeting import SlopeTravel
from drivers.agent.numbers import json_object, triple
from drivers.agent.settings import AgentSettings
from drivers.nc import LinearOffsets, NotSendable, Triple, check_offsets
from drivers.text import Text

Settled = Callable[[Callable[[], Awaitable[Sequence[float]]], Sequence[float]], Awaitable[None]]
"""Waits until what is read is what was written, for timeout_s at most."""


class AgentSlopes:
    """The slopes of one connected agent.

    owner: the number of the last heartbeat. settled: called after each write.
    """

    def __init__(
        self,
        agent: AgentConnection,
        settings: AgentSettings,
        travel: SlopeTravel,
        owner: Callable[[], int],
        settled: Settled,
    ) -> None:
        self._agent, self._settings, self._travel = agent, settings, travel
        self._owner, self._settled = owner, settled

    @property
    def pairs(self) -> frozenset[tuple[int, int]]:
        return self._travel.pairs

    @property
    def reference_mm(self) -> Triple:
        return self._travel.reference_mm

    @property
    def reach_mm(self) -> Triple:
        return self._travel.reach_mm

    async def write_linear(self, offsets: LinearOffsets) -> None:
        """Returns when they are in force, or after timeout_s.

        Raises NotSendable, before anything is sent, for a number that is not finite, an offset beyond `largest_um`
        anywhere in the travel, or a slope that the agent does not have.
        """
        self._check(offsets)
        slopes: list[Json] = [list(row) for row in offsets.slope_um_per_mm]
        await self._agent.ask("write_slopes", owner=self._owner(), um=list(offsets.k0_um), um_per_mm=slopes)

        async def found() -> tuple[float, ...]:
            return self._at_the_ends(await self.read_linear())

        await self._settled(found, self._at_the_ends(offsets))

    async def read_linear(self) -> LinearOffsets:
        device = self._settings.device
        told = json_object(await self._agent.ask("slopes"), "slopes", device)
        rows = told.get("um_per_mm")
        x, y, z = rows if isinstance(rows, list) and len(rows) == 3 else (rows, rows, rows)
        slopes = (triple(x, "slope of X", device), triple(y, "slope of Y", device), triple(z, "slope of Z", device))
        return LinearOffsets(triple(told.get("um"), "K0 in force", device), slopes, self.reference_mm)

    def _check(self, offsets: LinearOffsets) -> None:
        if not all(math.isfinite(v) for row in offsets.slope_um_per_mm for v in row):
            raise NotSendable(Text("slopes_not_finite", offsets=repr(offsets)))
        for shifted, row in enumerate(offsets.slope_um_per_mm):
            for over, slope in enumerate(row):
                if slope and (shifted, over) not in self.pairs:
                    raise NotSendable(Text("agent_no_slope", axis="XYZ"[shifted], over="XYZ"[over]))
        for k0, row in zip(offsets.k0_um, offsets.slope_um_per_mm, strict=True):
            largest = abs(k0) + sum(abs(s) * r for s, r in zip(row, self.reach_mm, strict=True))
            check_offsets((largest, 0.0, 0.0), self._settings.largest_um)
        if offsets.reference_mm != self.reference_mm:
            raise NotSendable(Text("agent_reference", found=str(offsets.reference_mm), own=str(self.reference_mm)))

    def _at_the_ends(self, offsets: LinearOffsets) -> tuple[float, ...]:
        """K0, and the largest addition by each slope, µm."""
        ends = (s * r for row in offsets.slope_um_per_mm for s, r in zip(row, self.reach_mm, strict=True))
        return (*offsets.k0_um, *ends)
