"""Telemetry: what is published over Zenoh, and under which keys."""

from gateway.telemetry import keys
from gateway.telemetry.compose import Composer
from gateway.telemetry.json_schema import schemas
from gateway.telemetry.messages import (
    TYPES,
    CompensationMessage,
    DecisionMessage,
    EventMessage,
    FrameMessage,
    MeasurementMessage,
    ModelMessage,
    ProbingMessage,
    ProbingState,
    Published,
    ReadingMessage,
    SensorFinding,
    SensorsMessage,
    StatusMessage,
    decode,
    encode,
)
from gateway.telemetry.publisher import Telemetry, TelemetryError

__all__ = [
    "TYPES",
    "CompensationMessage",
    "Composer",
    "DecisionMessage",
    "EventMessage",
    "FrameMessage",
    "MeasurementMessage",
    "ModelMessage",
    "ProbingMessage",
    "ProbingState",
    "Published",
    "ReadingMessage",
    "SensorFinding",
    "SensorsMessage",
    "StatusMessage",
    "Telemetry",
    "TelemetryError",
    "decode",
    "encode",
    "keys",
    "schemas",
]
