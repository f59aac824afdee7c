"""A control that gives any answer that a test sets, right or wrong, in each form of a control."""

from dataclasses import dataclass, field
from typing import Any, cast

from drivers.nc import LinearOffsets, NcSnapshot, NineErrors, RequestStatus, TakesSlopes, WatchdogTerms


@dataclass
class AnsweringControl:
    """Gets only a shift; `asked`: what it was asked so far."""

    answers: dict[str, Any] = field(default_factory=dict)
    asked: list[tuple[Any, ...]] = field(default_factory=list)

    def answer(self, operation: str, *given: object) -> Any:
        """What every operation returns. Raises what is set as its answer, if that is an error."""
        self.asked.append((operation, *given))
        answer = self.answers.get(operation)
        if isinstance(answer, Exception):
            raise answer
        return answer

    async def connect(self) -> None:
        self.answer("connect")

    async def close(self) -> None:
        self.answer("close")

    async def snapshot(self) -> NcSnapshot:
        return cast("NcSnapshot", self.answer("snapshot"))

    async def request_probing(self, number: int, dry_run_mm: float = 0.0) -> None:
        self.answer("request_probing", number)

    async def probing_status(self, number: int) -> RequestStatus:
        return cast("RequestStatus", self.answer("probing_status", number))

    async def withdraw_probing(self, number: int) -> None:
        self.answer("withdraw_probing", number)

    async def write_compensation(self, offsets_um: tuple[float, float, float]) -> None:
        self.answer("write_compensation", offsets_um)

    async def read_compensation(self) -> tuple[float, float, float]:
        return cast("tuple[float, float, float]", self.answer("read_compensation"))

    async def claim(self, owner: int, terms: WatchdogTerms, predecessor: int | None = None) -> None:
        self.answer("claim", owner, terms, predecessor)

    async def heartbeat(self, owner: int) -> bool:
        return cast("bool", self.answer("heartbeat", owner))

    async def release(self, owner: int) -> None:
        self.answer("release", owner)


class AnsweringLate(AnsweringControl):
    """Says for how long an unanswered write may take effect."""

    @property
    def late_write_s(self) -> float:
        return cast("float", self.answer("late_write_s"))


class AnsweringSlopes(AnsweringControl):
    """Takes slopes."""

    @property
    def pairs(self) -> frozenset[tuple[int, int]]:
        return cast("frozenset[tuple[int, int]]", self.answer("pairs"))

    @property
    def reference_mm(self) -> tuple[float, float, float]:
        return cast("tuple[float, float, float]", self.answer("reference_mm"))

    @property
    def reach_mm(self) -> tuple[float, float, float]:
        return cast("tuple[float, float, float]", self.answer("reach_mm"))

    async def write_linear(self, offsets: LinearOffsets) -> None:
        self.answer("write_linear", offsets)

    async def read_linear(self) -> LinearOffsets:
        return cast("LinearOffsets", self.answer("read_linear"))


class AnsweringErrors(AnsweringControl):
    """Takes the nine errors."""

    @property
    def error_reach_mm(self) -> tuple[float, float] | None:
        return cast("tuple[float, float] | None", self.answer("error_reach_mm"))

    @property
    def slopes(self) -> TakesSlopes | None:
        return cast("TakesSlopes | None", self.answer("slopes"))

    async def write_errors(self, errors: NineErrors) -> None:
        self.answer("write_errors", errors)

    async def read_errors(self, radius_mm: float) -> tuple[float, ...]:
        return cast("tuple[float, ...]", self.answer("read_errors", radius_mm))
