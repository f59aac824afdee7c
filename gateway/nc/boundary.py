"""The boundary between the link and a control's driver: beyond it there are only driver errors and valid answers."""

import logging
import math
import traceback
from collections.abc import Awaitable, Callable, Mapping
from datetime import datetime
from typing import NoReturn, TypeVar

from drivers.base import BadAnswer, DriverError, Quality, Refused
from drivers.nc import (
    AXES,
    ERRORS,
    FARTHEST_MM,
    LINEAR_AXES,
    FollowsErrors,
    FollowsPosition,
    ForgetsWrites,
    LinearOffsets,
    MarksPath,
    NcSnapshot,
    NineErrors,
    NotSendable,
    NumericalControl,
    OperatingMode,
    ProbingState,
    ProgramState,
    RequestStatus,
    RunsDry,
    TakesSlopes,
    Triple,
    WatchdogTerms,
)
from gateway.model.codes import NoticeCode
from gateway.model.text import Text
from gateway.runtime.boundary import uncancelled, unexpected

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
        self._logged: set[tuple[str, str, int | None]] = set()

    async def connect(self) -> None:
        await self.call("connect", self._nc.connect())

    async def close(self) -> None:
        await self.call("close", self._nc.close())

    async def snapshot(self) -> NcSnapshot:
        snapshot = await self.call("snapshot", self._nc.snapshot())
        try:
            _check_snapshot(snapshot)
        except (AttributeError, TypeError, ValueError, OverflowError) as error:
            self._unexpected("snapshot", error)
        _check_distance(snapshot.positions)
        return snapshot

    async def request_probing(self, number: int, dry_run_mm: float = 0.0) -> None:
        if not dry_run_mm:  # a driver of another package may not know of dry runs
            await self.call("request_probing", self._nc.request_probing(number))
        elif isinstance(self._nc, RunsDry):
            await self.call("request_probing", self._nc.request_probing(number, dry_run_mm))
        else:
            raise Refused(Text(NoticeCode.DRIVER_NO_DRY_RUNS), device="nc", hint=Text(NoticeCode.UPDATE_PACKAGE))

    @property
    def runs_dry(self) -> bool | None:
        """Implements RunsDry."""
        return self.told("runs_dry", lambda: _runs_dry(self._nc))

    @property
    def path_mark(self) -> str:
        """Implements MarksPath."""
        return self.told("path_mark", lambda: str(self._nc.path_mark) if isinstance(self._nc, MarksPath) else "")

    async def probing_status(self, number: int) -> RequestStatus:
        status = await self.call("probing_status", self._nc.probing_status(number))
        try:
            _check_status(status, number)
        except (AttributeError, TypeError, ValueError, OverflowError) as error:
            self._unexpected("probing_status", error)
        return status

    async def withdraw_probing(self, number: int) -> None:
        await self.call("withdraw_probing", self._nc.withdraw_probing(number))

    async def write_compensation(self, offsets_um: Triple) -> None:
        await self.call("write_compensation", self._nc.write_compensation(offsets_um))

    async def read_compensation(self) -> Triple:
        answer = await self.call("read_compensation", self._nc.read_compensation())
        return self.told("read_compensation", lambda: _triple(answer))

    @property
    def late_write_s(self) -> float:
        """0 where the driver does not know."""
        return self.told("late_write_s", lambda: _late(self._nc))

    async def claim(self, owner: int, terms: WatchdogTerms, predecessor: int | None = None) -> None:
        await self.call("claim", self._nc.claim(owner, terms, predecessor))

    async def heartbeat(self, owner: int) -> bool:
        return await self.call("heartbeat", self._nc.heartbeat(owner)) is True

    async def release(self, owner: int) -> None:
        await self.call("release", self._nc.release(owner))

    async def call(self, operation: str, work: Awaitable[T]) -> T:
        try:
            return await uncancelled(work)
        except (DriverError, NotSendable, MemoryError):
            raise
        except Exception as error:  # noqa: BLE001 - a driver's bug must not end the gateway
            self._unexpected(operation, error)

    def _unexpected(self, operation: str, error: Exception) -> NoReturn:
        place = (operation, type(error).__name__, traceback.extract_tb(error.__traceback__)[-1].lineno)
        if place not in self._logged:
            self._logged.add(place)
            log.error("NC: unexpected %s in %s", type(error).__name__, operation, exc_info=error)
        raise unexpected(error, operation, device="nc") from error

    def told(self, name: str, tell: Callable[[], T]) -> T:
        """A property of the driver, checked. Raises DriverError."""
        try:
            return tell()
        except (DriverError, MemoryError):
            raise
        except Exception as error:  # noqa: BLE001 - a driver's bug must not end the gateway
            self._unexpected(name, error)


def _runs_dry(nc: NumericalControl) -> bool | None:
    shown = isinstance(nc, RunsDry) and nc.runs_dry
    return None if shown is None else shown is True


class _SlopesBehind:
    """Implements TakesSlopes, behind a control's boundary."""

    def __init__(self, boundary: _Contained, slopes: TakesSlopes) -> None:
        self._boundary, self._slopes = boundary, slopes

    @property
    def pairs(self) -> frozenset[tuple[int, int]]:
        return self._boundary.told("pairs", lambda: _pairs(self._slopes.pairs))

    @property
    def reference_mm(self) -> Triple:
        return self._boundary.told("reference_mm", lambda: _triple(self._slopes.reference_mm))

    @property
    def reach_mm(self) -> Triple:
        return self._boundary.told("reach_mm", lambda: _lengths(_triple(self._slopes.reach_mm)))

    async def write_linear(self, offsets: LinearOffsets) -> None:
        await self._boundary.call("write_linear", self._slopes.write_linear(offsets))

    async def read_linear(self) -> LinearOffsets:
        answer = await self._boundary.call("read_linear", self._slopes.read_linear())
        return self._boundary.told("read_linear", lambda: _linear(answer))


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
        return self.told("error_reach_mm", lambda: _reach(self._errors.error_reach_mm))

    @property
    def slopes(self) -> TakesSlopes | None:
        slopes = self.told("slopes", lambda: self._errors.slopes)
        return None if slopes is None else _SlopesBehind(self, slopes)

    async def write_errors(self, errors: NineErrors) -> None:
        await self.call("write_errors", self._errors.write_errors(errors))

    async def read_errors(self, radius_mm: float) -> tuple[float, ...]:
        answer = await self.call("read_errors", self._errors.read_errors(radius_mm))
        return self.told("read_errors", lambda: _numbers(answer, ERRORS))


_Types = type | tuple[type, ...]
_OR_NOT: _Types = (bool, type(None))
_KINDS: Mapping[str, _Types] = {
    "time": datetime, "monotonic_s": (float, int), "mode": OperatingMode, "program": ProgramState, "quality": Quality,
    "tool": (int, type(None)), "probe_in_spindle": _OR_NOT, "ready": _OR_NOT, "probing": _OR_NOT,
    "cannot_probe": (str, type(None)), "cannot_probe_code": str, "alarms": tuple, "not_known": dict,
}  # fmt: skip
"""The type of each of a snapshot's other fields. A 0 instead of False would count as not False: offsets would be
written during an emergency stop."""


def _check_snapshot(snapshot: NcSnapshot) -> None:
    """Raises AttributeError, TypeError, ValueError or OverflowError for what the interface excludes."""
    for name, kind in _KINDS.items():
        if not isinstance(value := getattr(snapshot, name), kind):
            raise TypeError(f"{name} = {value!r}: of an unexpected type")
    if not all(isinstance(text, str) for pair in snapshot.not_known.items() for text in pair):
        raise TypeError(f"not_known = {snapshot.not_known!r}: expected texts")
    if snapshot.time.tzinfo is None:
        raise ValueError(f"time = {snapshot.time!r}: expected UTC")
    _check_numbers({"monotonic_s": snapshot.monotonic_s}, ())
    _check_numbers(snapshot.positions, AXES)
    _check_numbers(snapshot.states, ())


def _check_distance(positions: Mapping[str, float]) -> None:
    """Raises BadAnswer. A rotary axis may have turned often."""
    for axis in LINEAR_AXES:
        if abs(positions[axis]) > FARTHEST_MM:
            raise BadAnswer(
                Text(NoticeCode.POSITION_TOO_FAR, axis=axis, mm=positions[axis]),
                device="nc",
                hint=Text(NoticeCode.POSITION_HINT),
            )


def _check_status(status: RequestStatus, number: int) -> None:
    """As above; the centres are checked as a measurement."""
    ProbingState(status.state)
    if status.number != number:
        raise ValueError(f"number = {status.number!r}: expected {number}")
    if not isinstance(status.reason, str):
        raise TypeError(f"reason = {status.reason!r}: expected a text")
    if status.spread_mm is not None:
        _check_numbers({"spread_mm": status.spread_mm}, ())
    if status.in_force_um is not None:
        _check_numbers(dict(zip("XYZ", status.in_force_um, strict=True)), ())


def _numbers(values: object, count: int) -> tuple[float, ...]:
    """Raises TypeError, ValueError or OverflowError."""
    numbers = tuple(float(value) for value in values)  # type: ignore[attr-defined]
    if len(numbers) != count:
        raise ValueError(f"{values!r}: expected {count} numbers")
    return numbers


def _triple(values: object) -> Triple:
    x, y, z = _numbers(values, 3)
    return x, y, z


def _lengths(values: Triple) -> Triple:
    if not all(0.0 < value < math.inf for value in values):
        raise ValueError(f"{values!r}: expected three lengths")
    return values


def _reach(values: object) -> tuple[float, float] | None:
    if values is None:
        return None
    along, across = _numbers(values, 2)
    if not (0.0 <= along < math.inf and 0.0 <= across < math.inf):
        raise ValueError(f"{values!r}: expected two lengths")
    return along, across


def _late(nc: NumericalControl) -> float:
    value = float(nc.late_write_s) if isinstance(nc, ForgetsWrites) else 0.0
    if not value >= 0.0:
        raise ValueError(f"{value!r}: expected seconds, 0 or more")
    return value


def _pairs(pairs: frozenset[tuple[int, int]]) -> frozenset[tuple[int, int]]:
    if not all(shifted in range(3) and over in range(3) for shifted, over in pairs):
        raise ValueError(f"{pairs!r}: expected pairs of 0, 1, 2")
    return pairs


def _linear(answer: object) -> LinearOffsets:
    if not isinstance(answer, LinearOffsets):
        raise TypeError(f"{answer!r}: expected LinearOffsets")
    x, y, z = answer.slope_um_per_mm
    slopes = _triple(x), _triple(y), _triple(z)
    return LinearOffsets(_triple(answer.k0_um), slopes, _triple(answer.reference_mm))


def _check_numbers(values: Mapping[str, float], names: tuple[str, ...]) -> None:
    """Raises TypeError or ValueError unless all are finite numbers and the named ones are present."""
    if missing := [name for name in names if name not in values]:
        raise ValueError(f"no value of {', '.join(missing)}")
    for name, value in values.items():
        if not math.isfinite(value):
            raise ValueError(f"{name} = {value!r}: expected a finite number")
