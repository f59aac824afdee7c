"""SINUMERIK with slopes: K0, tanβ and P0 of each axis, and sag compensation tables across axes.

ΔK = K0 + tanβ (P - P0) per axis (SD43900, SD43910, SD43920; Function Manual Extended Functions, K3, temperature
compensation). A shift of one axis that depends on another's position uses sag compensation: a table that rises by
1 µm per mm from its zero at P0, times its weight SD41310 (K3, sag and angularity error compensation).
"""

import math
from typing import Final

from drivers.base import Clock, Refused
from drivers.nc import LINEAR_AXES, LinearOffsets, NotSendable, Triple, WatchdogTerms
from drivers.sinumerik.control import Sinumerik
from drivers.sinumerik.settings import SinumerikSettings
from drivers.text import Text

_SAME_MM: Final = 1e-6


class SinumerikWithSlopes(Sinumerik):
    """One control with route `k0_slope`. Implements FollowsPosition; errors like Sinumerik's."""

    def __init__(self, settings: SinumerikSettings, clock: Clock) -> None:
        comp = settings.compensation
        if comp.route != "k0_slope" or comp.travel_mm is None:
            raise ValueError(f"route = {comp.route!r}: expected 'k0_slope'")
        super().__init__(settings, clock)
        self._leased = (*self._leased, settings.r(settings.lease.slope_ramp))
        self._tables = settings.table_nodes
        self._slopes = settings.linear(settings.nodes.slope)
        self._references = settings.linear(settings.nodes.reference)
        self._form = (*self._offsets, *self._slopes, *self._references, *self._tables.values())
        low_high = zip(comp.travel_mm, comp.reference_mm, strict=True)
        x, y, z = (max(abs(low - p0), abs(high - p0)) for (low, high), p0 in low_high)
        self._reach: Triple = (x, y, z)
        self._found: tuple[list[float], list[float]] | None = None
        """P0 and slopes as last read; not None while connected."""

    @property
    def pairs(self) -> frozenset[tuple[int, int]]:
        return frozenset(self._tables) | {(axis, axis) for axis in range(3)}

    @property
    def reference_mm(self) -> Triple:
        return self._from_origin(*self._settings.compensation.reference_mm)

    @property
    def reach_mm(self) -> Triple:
        return self._reach

    async def connect(self) -> None:
        await super().connect()
        try:
            await self.read_linear()  # a write checks the P0 that was read last
        except BaseException:
            await self.close()
            raise

    async def claim(self, owner: int, terms: WatchdogTerms, predecessor: int | None = None) -> None:
        """Like Sinumerik's; also sets each P0 to ours. Raises Refused when a different one is in use with a slope."""
        await super().claim(owner, terms, predecessor)
        await self.read_linear()
        wrong = {path: wanted for path, wanted, _, slope in self._wrong_references() if not slope}
        if wrong:
            await self._session.write(wrong)
            await self.read_linear()
        self._check_references()

    async def write_linear(self, offsets: LinearOffsets) -> None:
        """Raises NotSendable, before anything is sent, for what is not finite, beyond `largest_um` somewhere in the
        travel, about another reference, or over a pair without a table; Refused when another P0 was read last.

        K0, slopes and weights go in one request, and nothing is asked before it: the caller has just checked that it
        may still be sent. On Refused some may have been set: read back.
        """
        self._check(offsets)
        self._check_references()
        comp = self._settings.compensation
        values = {}
        for axis in range(3):
            values[self._offsets[axis]] = comp.sign(axis) * offsets.k0_um[axis] * 1e-3
            values[self._slopes[axis]] = comp.sign(axis) * offsets.slope_um_per_mm[axis][axis] * 1e-3
        for (axis, over), path in self._tables.items():
            values[path] = comp.table_sign(axis) * offsets.slope_um_per_mm[axis][over]
        await self._session.write(values)

    async def read_linear(self) -> LinearOffsets:
        return self._offsets_from(self._numbers(self._form, await self._session.read(self._form)))

    @property
    def _writable(self) -> tuple[tuple[str, ...], ...]:
        return *super()._writable, self._slopes, self._references, tuple(self._tables.values())

    async def write_compensation(self, offsets_um: Triple) -> None:
        """The same shift at every position of the axes."""
        zero = (0.0, 0.0, 0.0)
        await self.write_linear(LinearOffsets(offsets_um, (zero, zero, zero), self.reference_mm))

    async def read_compensation(self) -> Triple:
        """The offsets at the present position."""
        values = self._numbers(self._in_force, await self._session.read(self._in_force))
        x, y, z = values[len(self._form) :]
        return self._offsets_from(values[: len(self._form)]).at(self._from_origin(x, y, z))

    def _watchdog_values(self, terms: WatchdogTerms) -> dict[str, float]:
        """Half of the rate for K0 and half for all slopes together, so that nothing moves faster than agreed."""
        lease, r = self._settings.lease, self._settings.r
        half = terms.ramp_um_per_s * 1e-3 / 2
        return {r(lease.silence): terms.silence_s, r(lease.ramp): half, r(lease.slope_ramp): half / sum(self._reach)}

    def _offsets_from(self, values: list[float]) -> LinearOffsets:
        """From the values of `_form`, relative to our reference whichever one the control has, which is kept."""
        comp = self._settings.compensation
        k0, slope, p0 = values[0:3], values[3:6], values[6:9]
        self._found = p0, slope
        rows = [[0.0] * 3 for _ in range(3)]
        at_reference = [0.0] * 3
        for axis in range(3):
            rows[axis][axis] = comp.sign(axis) * slope[axis] * 1e3
            moved = slope[axis] * (comp.reference_mm[axis] - p0[axis])
            at_reference[axis] = comp.sign(axis) * (k0[axis] + moved) * 1e3
        for ((axis, over), _), weight in zip(self._tables.items(), values[9:], strict=True):
            rows[axis][over] = comp.table_sign(axis) * weight
        x, y, z = ((row[0], row[1], row[2]) for row in rows)
        return LinearOffsets((at_reference[0], at_reference[1], at_reference[2]), (x, y, z), self.reference_mm)

    def _check(self, offsets: LinearOffsets) -> None:
        largest = self._settings.compensation.largest_um
        if offsets.reference_mm != self.reference_mm:
            raise NotSendable(Text("nc_reference", found=str(offsets.reference_mm), wanted=str(self.reference_mm)))
        for axis, name in enumerate(LINEAR_AXES):
            row = offsets.slope_um_per_mm[axis]
            if any(slope and (axis, over) not in self.pairs for over, slope in enumerate(row)):
                raise NotSendable(Text("nc_no_table", axis=name))
            effect = abs(offsets.k0_um[axis]) + sum(abs(s) * r for s, r in zip(row, self._reach, strict=True))
            if not math.isfinite(effect):
                raise NotSendable(Text("nc_offsets_not_finite", axis=name))
            if effect > largest:
                raise NotSendable(Text("nc_offsets_reach", axis=name, um=effect, most_um=largest))

    def _wrong_references(self) -> list[tuple[str, float, float, float]]:
        """Each axis whose P0 is not ours: its path, our P0, the one found, and the slope in force."""
        if self._found is None:
            return []
        found = zip(self._references, self._settings.compensation.reference_mm, *self._found, strict=True)
        return [(path, wanted, p0, slope) for path, wanted, p0, slope in found if abs(p0 - wanted) > _SAME_MM]

    def _check_references(self) -> None:
        """A reference can be moved without a step only while its slope is zero."""
        for path, wanted, p0, slope in self._wrong_references():
            name = LINEAR_AXES[self._references.index(path)]
            raise Refused(
                Text("nc_p0_slope" if slope else "nc_p0", axis=name, p0=p0, wanted=wanted),
                device=self._settings.device,
                hint=Text("nc_p0_slope_hint" if slope else "nc_p0_hint"),
            )
