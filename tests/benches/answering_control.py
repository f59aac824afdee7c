"""A control that answers whatever it is told to, right or wrong, in each of the three forms of a control."""

from dataclasses import dataclass, field
from typing import Any, cast

from drivers.nc import LinearOffsets, NcSnapshot, NineErrors, RequestStatus, TakesSlopes, WatchdogTerms


@dataclass
class AnsweringControl:
    """Gets a shift alone; `asked`: what it was asked so far."""

    answers: dict[str, Any] = field(default_factory=dict)
    asked: list[tuple[Any, ...]] = field(default_factory=list)

    def _answer(self, operation: str, *given: object) -> Any:
        self.asked.append((operation, *given))
        answer = self.answers.get(operation)
        if isinstance(answer, Exception):
            raise answer
        return answer

    async def connect(self) -> None:
        self._answer("connect")

    async def close(self) -> None:
        self._answer("close")

    async def snapshot(self) -> NcSnapshot:
        return cast("NcSnapshot", self._answer("snapshot"))

    async def request_probing(self, number: int) -> None:
        self._answer("request_probing", number)

    async def probing_status(self, number: int) -> RequestStatus:
        return cast("RequestStatus", self._answer("probing_status", number))

    async def withdraw_probing(self, number: int) -> None:
        self._answer("withdraw_probing", number)

    async def write_compensation(self, offsets_um: tuple[float, float, float]) -> None:
        self._answer("write_compensation", offsets_um)

    async def read_compensation(self) -> tuple[float, float, float]:
        return cast("tuple[float, float, float]", self._answer("read_compensation"))

    async def claim(self, owner: int, terms: WatchdogTerms, predecessor: int | None = None) -> None:
        self._answer("claim", owner, terms, predecessor)

    async def heartbeat(self, owner: int) -> bool:
        return cast("bool", self._answer("heartbeat", owner))

    async def release(self, owner: int) -> None:
        self._answer("release", owner)


class AnsweringSlopes(AnsweringControl):
    """Takes slopes."""

    @property
    def pairs(self) -> frozenset[tuple[int, int]]:
        return cast("frozenset[tuple[int, int]]", self._answer("pairs"))

    @property
    def reference_mm(self) -> tuple[float, float, float]:
        return cast("tuple[float, float, float]", self._answer("reference_mm"))

    @property
    def reach_mm(self) -> tuple[float, float, float]:
        return cast("tuple[float, float, float]", self._answer("reach_mm"))

    async def write_linear(self, offsets: LinearOffsets) -> None:
        self._answer("write_linear", offsets)

    async def read_linear(self) -> LinearOffsets:
        return cast("LinearOffsets", self._answer("read_linear"))


class AnsweringErrors(AnsweringControl):
    """Takes the nine errors."""

    @property
    def error_reach_mm(self) -> tuple[float, float] | None:
        return cast("tuple[float, float] | None", self._answer("error_reach_mm"))

    @property
    def slopes(self) -> TakesSlopes | None:
        return cast("TakesSlopes | None", self._answer("slopes"))

    async def write_errors(self, errors: NineErrors) -> None:
        self._answer("write_errors", errors)

    async def read_errors(self, radius_mm: float) -> tuple[float, ...]:
        return cast("tuple[float, ...]", self._answer("read_errors", radius_mm))
