"""A publisher with something to publish, and a reader of its last values."""

import json
import math
from datetime import UTC, datetime
from typing import Any

import numpy as np

from drivers.base import Clock, Quality, SystemClock
from gateway.config.telemetry import Telemetry as Settings
from gateway.model.events import EventReported
from gateway.model.sample import Sample
from talc.frame import Decision, Event, EventKind, Phase
from tests.benches.open_publisher import OpenPublisher
from tests.benches.waits import LIMIT_S, wait_until
from tests.benches.zenoh_sessions import client

NOW = datetime(2026, 1, 5, 6, tzinfo=UTC)
ROOT = "talc/mill"
NAMES = ("t0", "t1")


def telemetry(port: int, clock: Clock | None = None, **given: Any) -> OpenPublisher:
    """given: its sources, and other arguments of the publisher"""
    settings = Settings(listen=(f"tcp/127.0.0.1:{port}",))
    return OpenPublisher(settings, "mill", NAMES, clock or SystemClock(), "boot-1", simulated=False, **given)


def reading(value: float, quality: Quality = Quality.GOOD) -> Sample:
    return Sample("t0", value, "degC", quality, NOW, 0.0, sequence=1)


def decision(k: int) -> Decision:
    nan = np.full(9, math.nan)
    return Decision(k, Phase.CALIBRATION, np.arange(9.0), nan, nan, nan, None, None, ())


def problem(text: str) -> EventReported:
    return EventReported(Event(EventKind.PROBLEM, text), 7)


def last_values(port: int, last: str = "") -> dict[str, Any]:
    """What a query gives for each key, once it gives the event that the test published last.

    last: its text; empty: the test has published one event
    """
    found: dict[str, Any] = {}
    with client(port) as session:

        def is_there() -> bool:
            replies = session.get(f"{ROOT}/**", timeout=LIMIT_S)
            found.update({str(r.ok.key_expr): json.loads(r.ok.payload.to_bytes()) for r in replies if r.ok is not None})
            return last in found.get(f"{ROOT}/event", {"text": ()})["text"]

        wait_until(is_there)  # the publishing thread may still be at it
    return found
