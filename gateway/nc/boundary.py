"""The boundary between the link and a control's driver: beyond it there are only driver errors and valid answers."""

import logging
import math
import traceback
from collections.abc import Awaitable, Mapping
from typing import NoReturn, TypeVar

from drivers.base import DriverError
from drivers.nc import (
    AXES,
    ERRORS,
    FollowsErrors,
    FollowsPosition,
    LinearOffsets,
    NcSnapshot,
    NineErrors,
    NotSendable,
    NumericalControl,
    ProbingState,
    RequestStatus,
    TakesSlopes,
    Triple,
    WatchdogTerms,
)
from gateway.polling import uncancelled, unexpected

log = logging.getLogger(__name__)

T = TypeVar("T")


def contained_control(nc: NumericalControl) -> NumericalControl:
    """The control behind the boundary: it raises DriverError, and NotSendable where that is declared."""
    if isinstance(nc, FollowsPosition):
        return _ContainedSlopes(nc)
    return _ContainedErrors(nc) if isinstance(nc, FollowsErrors) else _Contained(nc)


class _Contained:
    """Implements NumericalControl. The traceback of an unexpected exception is logged once for each place."""

    def __init__(self, nc: NumericalControl) -> None:
        self._nc = nc
        self._logged: set[tuple[str, str, int]] = set()

    async def connect(self) -> None:
        await self._call("connect", self._nc.connect())

    async def close(self) -> None:
        await self._call("close", self._nc.close())

    async def snapshot(self) -> NcSnapshot:
        snapshot = await self._call("snapshot", self._nc.snapshot())
        try:
            _check_numbers(snapshot.positions, AXES)
            _check_numbers(snapshot.states, ())
        except (AttributeError, TypeError, ValueError, OverflowError) as error:
            self._unexpected("snapshot", error)
        return snapshot

    async def request_probing(self, number: int) -> None:
        await self._call("request_probing", self._nc.request_probing(number))

    async def probing_status(self, number: int) -> RequestStatus:
        status = await self._call("probing_status", self._nc.probing_status(number))
        try:
            ProbingState(status.state)
        except (AttributeError, ValueError) as error:
            self._unexpected("probing_status", error)
        return status

    async def withdraw_probing(self, number: int) -> None:
        await self._call("withdraw_probing", self._nc.withdraw_probing(number))

    async def write_compensation(self, offsets_um: Triple) -> None:
        await self._call("write_compensation", self._nc.write_compensation(offsets_um))

    async def read_compensation(self) -> Triple:
        answer = await self._call("read_compensation", self._nc.read_compensation())
        try:
            x, y, z = (float(value) for value in answer)
        except (TypeError, ValueError, OverflowError) as error:
            self._unexpected("read_compensation", error)
        return x, y, z

    async def claim(self, owner: int, terms: WatchdogTerms, predecessor: int | None = None) -> None:
        await self._call("claim", self._nc.claim(owner, terms, predecessor))

    async def heartbeat(self, owner: int) -> bool:
        return await self._call("heartbeat", self._nc.heartbeat(owner)) is True

    async def release(self, owner: int) -> None:
        await self._call("release", self._nc.release(owner))

    async def _call(self, operation: str, work: Awaitable[T]) -> T:
        try:
            return await uncancelled(work)
        except (DriverError, NotSendable, MemoryError):
            raise
        except Exception as error:  # noqa: BLE001 - a driver's bug must not end the gateway
            self._unexpected(operation, error)

    def _unexpected(self, operation: str, error: Exception) -> NoReturn:
        frames = traceback.extract_tb(error.__traceback__)
        place = (operation, type(error).__name__, (frames[-1].lineno or 0) if frames else 0)
        if place not in self._logged:
            self._logged.add(place)
            log.error("NC: unexpected %s in %s", type(error).__name__, operation, exc_info=error)
        raise unexpected(error, operation, device="nc") from error


class _SlopesBehind:
    """Implements TakesSlopes, behind a control's boundary."""

    def __init__(self, boundary: _Contained, slopes: TakesSlopes) -> None:
        self._boundary, self._slopes = boundary, slopes

    @property
    def pairs(self) -> frozenset[tuple[int, int]]:
        return self._slopes.pairs

    @property
    def reference_mm(self) -> Triple:
        return self._slopes.reference_mm

    @property
    def reach_mm(self) -> Triple:
        return self._slopes.reach_mm

    async def write_linear(self, offsets: LinearOffsets) -> None:
        await self._boundary._call("write_linear", self._slopes.write_linear(offsets))

    async def read_linear(self) -> LinearOffsets:
        answer = await self._boundary._call("read_linear", self._slopes.read_linear())
        if not isinstance(answer, LinearOffsets):
            self._boundary._unexpected("read_linear", TypeError(f"{answer!r}: expected LinearOffsets"))
        return answer


class _ContainedSlopes(_SlopesBehind, _Contained):
    """Implements FollowsPosition."""

    def __init__(self, nc: FollowsPosition) -> None:
        _Contained.__init__(self, nc)
        _SlopesBehind.__init__(self, self, nc)


class _ContainedErrors(_Contained):
    """Implements FollowsErrors."""

    def __init__(self, nc: FollowsErrors) -> None:
        super().__init__(nc)
        self._errors = nc

    @property
    def error_reach_mm(self) -> tuple[float, float] | None:
        return self._errors.error_reach_mm

    @property
    def slopes(self) -> TakesSlopes | None:
        slopes = self._errors.slopes
        return None if slopes is None else _SlopesBehind(self, slopes)

    async def write_errors(self, errors: NineErrors) -> None:
        await self._call("write_errors", self._errors.write_errors(errors))

    async def read_errors(self, radius_mm: float) -> tuple[float, ...]:
        answer = await self._call("read_errors", self._errors.read_errors(radius_mm))
        try:
            told = tuple(float(value) for value in answer)
        except (TypeError, ValueError, OverflowError) as error:
            self._unexpected("read_errors", error)
        if len(told) != ERRORS:
            self._unexpected("read_errors", ValueError(f"{answer!r}: expected nine errors"))
        return told


def _check_numbers(values: Mapping[str, float], names: tuple[str, ...]) -> None:
    """Raises TypeError or ValueError unless all are finite numbers and the named ones are present."""
    if missing := [name for name in names if name not in values]:
        raise ValueError(f"no value of {', '.join(missing)}")
    for name, value in values.items():
        if not math.isfinite(value):
            raise ValueError(f"{name} = {value!r}: expected a finite number")
