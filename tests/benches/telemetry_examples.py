"""One value of each kind that a gateway publishes, with numbers that are awkward in JSON."""

import math
from datetime import UTC, datetime

import numpy as np

from drivers.base import Quality
from gateway.config.extended import validate
from gateway.config.model import GatewayConfig
from gateway.model.compensation import Source, Step, Write
from gateway.model.probing import End, Outcome, Outlook
from gateway.model.sample import Sample
from gateway.model.standing import Standing
from gateway.model.text import plain
from talc.explanation import ErrorReason, Reasons
from talc.forecast import Forecast, Misses
from talc.frame import Decision, Event, EventKind, Frame, Measurement, Phase, Why
from talc.models import ErrorModel, ModelSet
from talc.names import THERMAL_ERRORS
from talc.sensor_check import Finding, Judgement

NOW = datetime(2026, 1, 5, 6, 0, 0, 250000, tzinfo=UTC)
LATER = datetime(2026, 1, 5, 6, 2, tzinfo=UTC)
NAMES = ("bed_front", "spindle_growth", "Öl")
MONOTONIC_S = 1234.5
NINE = np.array([1.5, -0.0, 1 / 3, math.nan, 0.1 + 0.2, 12345678.9, 2.0, math.inf, -4.25])

READING = Sample("bed_front", 20.0, "degC", Quality.GOOD, NOW, 1233.2496, sequence=17)
BAD_READING = Sample(
    "Öl", math.nan, "degC", Quality.SENSOR_FAULT, LATER, 2000.0, 'sensor "open"\n\tor \\ shorted \x1f', sequence=18
)
MEASUREMENT = Measurement(NINE, np.full(9, 0.5))
FRAME = Frame(7, np.array([20.5, math.nan, 3.25]), np.array([True, False, False]))
MEASURED_FRAME = Frame(8, np.array([20.5, math.inf, 3.25]), np.array([True, True, True]), MEASUREMENT)
DECISION = Decision(
    7, Phase.COMPENSATION, NINE, NINE[::-1].copy(), np.abs(NINE), np.full(9, 5.0), Why.INTERVAL, None, (),
    ("spindle_growth",),
)  # fmt: skip
FIRST_DECISION = Decision(
    1, Phase.CALIBRATION, np.full(9, math.nan), np.zeros(9), np.ones(9), np.full(9, math.nan), None, None, ()
)
REASONS = Reasons(
    7, 19, Why.UNCERTAINTY,
    (
        ErrorReason(
            "EY0A", 4.5, True, 0.9, (("bed_front", 4.0), ("Öl", -1.0)), 0.5, 1.0, (("chosen inputs", 0.75),), 6.0, 1.5
        ),
        ErrorReason("EX0C", math.nan, False, 0.5, (), 0.0, 0.0, (), math.nan, math.nan),
    ),
)  # fmt: skip
FORECAST = Forecast(
    7, (6, 96), (1800.0, 28800.0), np.stack([NINE, NINE]), np.ones((2, 9)), np.full((2, 9), 0.5), np.zeros((2, 9)),
    np.full((2, 9), 1 / 3),
)  # fmt: skip
MISSES = Misses(np.full((2, 9), 2.0), np.full((2, 9), math.nan))
OUTCOME = Outcome(41, Why.CALIBRATION, NOW, LATER, np.zeros((6, 3)), (0.0, -1.5, 1 / 3), MEASUREMENT, 0.4)
PER_POSE = Outcome(43, Why.INTERVAL, NOW, LATER, None, ((0.0, 1.0, 2.0), (3.0, 4.0, 5.5)), MEASUREMENT, 0.25)
REFUSED = Outcome(
    42, Why.RETRY, NOW, LATER, None, (0.0, 0.0, 0.0), None, math.nan, plain("refused: alarm 21612"), End.REFUSED
)
MODEL = ErrorModel(
    error="EY0A", inputs=("bed_front", "Öl"), a=np.array([-1.2, 0.45]), b=(np.array([0.5, 0.5]), np.array([1.0])),
    u_mean=np.zeros(2), u_std=np.ones(2), y_mean=0.0, y_std=1.0, u_low=np.full(2, -100.0), u_high=np.full(2, 100.0),
    y_low=-300.0, y_high=300.0, limit=3.0, training_limit=3.0, residual_std=1 / 3, criterion=-12.5,
)  # fmt: skip
MODELS = ModelSet(
    k=7,
    why="calibration",
    input_names=("bed_front", "Öl"),
    models=tuple(MODEL if error == "EY0A" else None for error in THERMAL_ERRORS),
)
PROBLEM = Event(EventKind.PROBLEM, "device rtd1: no answer")
LIMIT = Event(EventKind.LIMIT_EXCEEDED, "EY0A exceeds its limit", "EY0A", 0.1 + 0.2, 5.0)
NO_NUMBER = Event(EventKind.MODEL_REJECTED, "EX0C: no model", "EX0C", math.nan, math.inf)
WRITE = Write(
    NOW, "compensate",
    Step((10.0, 0.0, -3.0), (1.0, 0.0, -1 / 3), Source.PREDICTION, (True, False, False),
         ((1.0, 0.5), (0.0, 0.0), (-1 / 3, 0.0))),
    7, {"X": 1.0, "C": -90.5}, True, (1.0, 0.0, -0.25),
)  # fmt: skip
ADVICE = Write(
    LATER, "advise", Step((0.0, 0.0, 9.0), (0.0, 0.0, 3.0), Source.NO_MODEL, (False,) * 3), None, {}, False, None
)
OUTLOOK = Outlook(Standing.BLOCKED, Why.INTERVAL, plain("alarm 21612"), 2, plain("clean the sphere"))
NO_WISH = Outlook(Standing.NOT_WANTED, None)
JUDGEMENT = Judgement(
    (Finding("swap", ("a", "b"), math.nan, 2.5), Finding("offset", ("c",), -1.25, 1.0, ("d", "e"))),
    {"a": 0.5, "b": math.inf},
    (("a", "b"), ("c", "d")),
)


def configuration(machine: str) -> GatewayConfig:
    """A configuration with nothing but a name."""
    return validate({"machine": {"name": machine}})
