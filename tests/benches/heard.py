"""Messages as a page hears them from one machine, with the time as an argument, and a machine that has heard them."""

from collections.abc import Mapping
from datetime import UTC, datetime, timedelta

from gateway.telemetry import (
    CompensationMessage,
    DecisionMessage,
    EventMessage,
    MeasurementMessage,
    ProbingMessage,
    Published,
    ReadingMessage,
    StatusMessage,
)
from gateway.web.seen import MachineSeen
from talc.names import THERMAL_ERRORS

BEGAN = datetime(2026, 1, 5, 6, tzinfo=UTC)
STEP = timedelta(minutes=5)
BOOT = "boot-1"


class HeardMachine:
    """One machine's messages, numbered as a gateway numbers them, and what a page makes of them.

    Parameters
    ----------
    alive: whether its token is there
    """

    def __init__(self, *, alive: bool = True) -> None:
        self.seen = MachineSeen("mill")
        self.now, self.now_s, self._seq, self.boot = BEGAN, 0.0, 0, BOOT
        if alive:
            self.seen.appear(BEGAN)

    def passes(self, time: timedelta) -> None:
        """Nothing is heard for that long."""
        self.now, self.now_s = self.now + time, self.now_s + time.total_seconds()

    def hear(self, suffix: str, message: Published) -> None:
        self.seen.apply(suffix, message, self.now, self.now_s)

    def stamp(self) -> tuple[str, int, str, str]:
        self._seq += 1
        return self.boot, self._seq, self.now.isoformat(), "system"

    def decision(
        self,
        k: int = 0,
        corrected: float | Mapping[str, float | None] | None = 0.0,
        sigma: float | Mapping[str, float | None] | None = 0.1,
        phase: str = "compensation",
    ) -> None:
        """Errors that are not named are zero, and their sigma is 0.1."""
        values, spread = _by_error(corrected, 0.0), _by_error(sigma, 0.1)
        self.hear(
            "decision",
            DecisionMessage(
                *self.stamp(), k, phase, values, values, spread, dict.fromkeys(THERMAL_ERRORS, 5.0), None, None, ()
            ),
        )

    def compensation(
        self,
        offsets_um: tuple[float, float, float] = (0.0, 0.0, 0.0),
        target_um: tuple[float, float, float] | None = None,
        source: str = "prediction",
        mode: str = "compensate",
        *,
        k: int | None = 0,
        bounded: tuple[bool, bool, bool] = (False, False, False),
        written: bool = True,
    ) -> None:
        target = offsets_um if target_um is None else target_um
        self.hear(
            "compensation",
            CompensationMessage(
                *self.stamp(), k, mode, source, target, offsets_um, (), bounded, {}, written, offsets_um
            ),
        )

    def measurement(self, number: int = 1, errors: float | None = 0.0, sigma: float = 0.5, reason: str = "") -> None:
        known = None if errors is None else _by_error(errors, 0.0)
        spread = None if errors is None else _by_error(sigma, 0.0)
        at = self.now.isoformat()
        self.hear(
            "measurement",
            MeasurementMessage(*self.stamp(), number, "interval", at, at, known, spread, 0.4, [0.0, 0.0, 0.0], reason),
        )

    def reading(self, channel: str, value: float | None = 21.5, quality: str = "good", unit: str = "degC") -> None:
        at = self.now.isoformat()
        self.hear(f"reading/{channel}", ReadingMessage(*self.stamp(), channel, value, unit, quality, at, 0.0, 1, ""))

    def event(self, kind: str = "problem", text: str = "bus rtu1: no answer") -> None:
        self.hear("event", EventMessage(*self.stamp(), None, kind, text, None, None, None))

    def probing(self, standing: str, why: str | None = "interval", reason: str = "", operator: str = "") -> None:
        self.hear("probing", ProbingMessage(*self.stamp(), standing, why, reason, 0, operator))

    def status(self, unarmed: tuple[str, ...] = ()) -> None:
        self.hear("status", StatusMessage(*self.stamp(), "compensation", 0, 0, {}, None, None, unarmed=unarmed))


def _by_error(given: float | Mapping[str, float | None] | None, other: float) -> dict[str, float | None]:
    if isinstance(given, Mapping):
        return {name: given.get(name, other) for name in THERMAL_ERRORS}
    return dict.fromkeys(THERMAL_ERRORS, given)
