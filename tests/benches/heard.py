"""Messages as a page hears them from one machine, with the time as an argument, and a machine that has heard them."""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime, timedelta

from gateway.telemetry.fields import Coded
from gateway.telemetry.messages import (
    CompensationMessage,
    DecisionMessage,
    EventMessage,
    ForecastMessage,
    MeasurementMessage,
    PauseStanding,
    ProbingMessage,
    Published,
    PublishedCourse,
    PublishedReason,
    ReadingMessage,
    ReasonsMessage,
    SensorFinding,
    SensorsMessage,
    StatusMessage,
)
from gateway.telemetry.subscriber.machine import MachineSeen
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
        """Let time pass in which nothing is heard."""
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
        substituted: tuple[str, ...] = (),
    ) -> None:
        """Errors that are not named are zero, and their sigma is 0.1."""
        values, spread = _by_error(corrected, 0.0), _by_error(sigma, 0.1)
        self.hear(
            "decision",
            DecisionMessage(
                *self.stamp(),
                k,
                phase,
                values,
                values,
                spread,
                dict.fromkeys(THERMAL_ERRORS, 5.0),
                None,
                None,
                substituted,
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

    def forecast(
        self,
        stays: Mapping[str, Sequence[float]],
        *,
        sigma: float = 0.1,
        missed: float | None = 0.0,
        measured: float | None = None,
        usual: Mapping[str, Sequence[float]] | None = None,
        usual_sigma: float | None = None,
        k: int = 0,
        ahead_s: tuple[float, ...] = (1800.0, 7200.0, 28800.0),
        planned: Mapping[str, Mapping[str, Sequence[float]] | None] | None = None,
    ) -> None:
        """Errors that are not named stay zero. Of the value and of sigma, forecasts have been off by `missed`."""
        size = len(ahead_s)

        def courses(values: Mapping[str, Sequence[float]], spread: float) -> dict[str, PublishedCourse]:
            return {
                name: PublishedCourse(list(values.get(name, [0.0] * size)), [spread] * size) for name in THERMAL_ERRORS
            }

        message = ForecastMessage(
            *self.stamp(),
            k=k,
            ahead_s=ahead_s,
            stays=courses(stays, sigma),
            usual=courses(stays if usual is None else usual, sigma if usual_sigma is None else usual_sigma),
            measured={name: [sigma if measured is None else measured] * size for name in THERMAL_ERRORS},
            missed={name: PublishedCourse([missed] * size, [missed] * size) for name in THERMAL_ERRORS},
            planned={load: {} if v is None else courses(v, sigma) for load, v in (planned or {}).items()},
        )
        self.hear("forecast", message)

    def reasons(self, k: int = 0, trusted: tuple[str, ...] = ("EZ0A",)) -> None:
        """EZ0A and others are moved by a spindle, and by a bed a little; what is not trusted is not corrected."""
        errors = {
            error: PublishedReason(
                estimate=33.0 if error in trusted else 0.0,
                trusted=error in trusted,
                believed=0.9,
                inputs={"spindle_rear": 30.0, "bed": -2.0},
                other_inputs=4.0,
                level=1.0,
                experts={"chosen inputs": 0.75, "all inputs": 0.22, "last measurement held": 0.03},
                expected=33.0,
                expected_sigma=2.0,
            )
            for error in THERMAL_ERRORS
        }
        self.hear("reasons", ReasonsMessage(*self.stamp(), k, k + 12, "interval", errors))

    def sensors(
        self, smallest_offset_K: dict[str, float | None], *findings: SensorFinding, loads: tuple[str, ...] = ()
    ) -> None:
        self.hear("sensors", SensorsMessage(*self.stamp(), 0, findings, smallest_offset_K, (), loads))

    def measurement(
        self,
        number: int = 1,
        errors: float | None = 0.0,
        sigma: float = 0.5,
        reason: str = "",
        residual_um: float | None = 0.4,
    ) -> None:
        known = None if errors is None else _by_error(errors, 0.0)
        spread = None if errors is None else _by_error(sigma, 0.0)
        at = self.now.isoformat()
        self.hear(
            "measurement",
            MeasurementMessage(
                *self.stamp(), number, "interval", at, at, known, spread, residual_um, [0.0, 0.0, 0.0], reason
            ),
        )

    def reading(self, channel: str, value: float | None = 21.5, quality: str = "good", unit: str = "degC") -> None:
        at = self.now.isoformat()
        self.hear(f"reading/{channel}", ReadingMessage(*self.stamp(), channel, value, unit, quality, at, 0.0, 1, ""))

    def event(
        self,
        kind: str = "problem",
        text: str = "bus rtu1: no answer",
        subject: object = "",
        code: str = "",
        **values: object,
    ) -> None:
        own = values | ({"subject": subject} if subject else {})
        self.hear("event", EventMessage(*self.stamp(), None, kind, text, None, None, None, code=code, values=own))

    def probing(self, standing: str, why: str | None = "interval", reason: str = "", operator: str = "") -> None:
        self.hear("probing", ProbingMessage(*self.stamp(), standing, why, reason, 0, operator))

    def status(
        self,
        unarmed: tuple[str, ...] = (),
        certificates: Mapping[str, str] | None = None,
        periods_missed: Mapping[str, int] | None = None,
        planned_loads: tuple[str, ...] = (),
        paused: PauseStanding | None = None,
        disarmed: PauseStanding | None = None,
        unarmed_coded: tuple[Coded | None, ...] = (),
        channels: int | None = None,
        channels_good: int | None = None,
        when_stale: str | None = None,
        nc: str | None = None,
    ) -> None:
        ends, missed = dict(certificates or {}), dict(periods_missed or {})
        message = StatusMessage(
            *self.stamp(), "compensation", 0, 0, missed, None, None,
            unarmed=unarmed, certificates=ends, planned_loads=planned_loads, paused=paused, disarmed=disarmed,
            unarmed_coded=unarmed_coded, channels=channels, channels_good=channels_good, when_stale=when_stale, nc=nc,
        )  # fmt: skip
        self.hear("status", message)


def _by_error(given: float | Mapping[str, float | None] | None, other: float) -> dict[str, float | None]:
    if isinstance(given, Mapping):
        return {name: given.get(name, other) for name in THERMAL_ERRORS}
    return dict.fromkeys(THERMAL_ERRORS, given)
