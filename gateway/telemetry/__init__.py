"""Telemetry: the messages that are published over Zenoh, and their keys."""

from gateway.telemetry import keys
from gateway.telemetry.compose import Composer, Dropped
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
    ProbingStanding,
    Published,
    PublishedReason,
    ReadingMessage,
    ReasonsMessage,
    SensorFinding,
    SensorsMessage,
    StatusMessage,
    StorageStanding,
    decode,
    encode,
)
from gateway.telemetry.publisher import TelemetryError, TelemetryPublisher

__all__ = [
    "TYPES",
    "CompensationMessage",
    "Composer",
    "DecisionMessage",
    "Dropped",
    "EventMessage",
    "FrameMessage",
    "MeasurementMessage",
    "ModelMessage",
    "ProbingMessage",
    "ProbingStanding",
    "Published",
    "PublishedReason",
    "ReadingMessage",
    "ReasonsMessage",
    "SensorFinding",
    "SensorsMessage",
    "StatusMessage",
    "StorageStanding",
    "TelemetryError",
    "TelemetryPublisher",
    "decode",
    "encode",
    "keys",
    "schemas",
]
