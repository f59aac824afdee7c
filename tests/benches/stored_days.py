"""A database of two days, a step of each hour."""

from datetime import UTC, date, datetime, timedelta
from pathlib import Path

import numpy as np

from gateway.control.restart.earlier import earlier_run
from gateway.model.compensation import Source, Step, Write
from gateway.model.events import CompensationStepped, EventReported, MeasurementEnded
from gateway.model.probing import Outcome
from gateway.storage.store import Store
from talc.frame import Event, EventKind, Frame, Measurement, Why
from tests.benches.service_file import two_temperatures
from tests.benches.stepped_clock import SteppedClock
from tests.benches.stored_steps import record_step

DAY = date(2026, 3, 2)
STEP_S = 300
EACH = 12
"""One step of each hour is stored."""


def two_days(path: Path, first: datetime = datetime(2026, 3, 1, 22, tzinfo=UTC), hours: int = 30) -> Path:
    """A step of each hour, `column` without a value at noon UTC; at each sixth one a measurement, a step of the
    compensation and an event."""
    config = two_temperatures(path)
    k = int(first.timestamp()) // STEP_S
    with Store(path, "first", SteppedClock()) as store:
        store.begin(config.canonical(), config.fingerprint(), "")
        controller = earlier_run(store, config).controller
        for hour in range(hours):
            at, measured = first + timedelta(hours=hour), None
            if hour % 6 == 0:
                measured = Measurement(np.full(9, float(hour)), np.full(9, 0.5))
                found = Outcome(hour, Why.INTERVAL, at, at, np.zeros((6, 3)), (0.0, 0.0, 0.0), measured, 0.4)
                store.record(MeasurementEnded(found))
                step = Step((0.0, 0.0, 9.0), (0.0, 0.0, float(hour)), Source.PREDICTION, (False, False, False))
                store.record(CompensationStepped(Write(at, "advise", step, k, {"X": 1.0}, False, None)))
                store.record(EventReported(Event(EventKind.PROBLEM, f"at hour {hour}"), k))
            frame = Frame(k + hour * EACH, np.array([20.0 + hour, 21.0]), np.array([True, at.hour != 12]), measured)
            record_step(store, controller, frame)
    return path
