"""Parts of the controller's steps: gaps, errors with and without a model, and what its events say."""

import numpy as np
import pytest

from talc.control import Controller
from talc.frame import EventKind, Frame, Measurement
from talc.names import THERMAL_ERRORS
from talc.settings import ControlSettings, TalcSettings
from tests.benches.control_models import INPUTS, models

CALIBRATION = 12


def frame(k: int, measured: float | None = None) -> Frame:
    errors = None if measured is None else Measurement(np.full(9, measured), np.ones(9))
    return Frame(k, np.array([1.0, 20.0]), np.ones(2, dtype=np.bool_), errors)


def taught(only: tuple[str, ...] = THERMAL_ERRORS) -> tuple[Controller, list[EventKind]]:
    """With models, and what happened during the calibration."""
    control = ControlSettings(calibration_steps=CALIBRATION, measurement_interval_steps=4, no_good_measurements=3)
    c = Controller(INPUTS, TalcSettings(method="models", control=control))
    events = [event.kind for k in range(CALIBRATION) for event in c.step(frame(k, measured=2.0)).events]
    c.adopt(models(CALIBRATION - 1, only))
    return c, events


@pytest.mark.parametrize(("gap", "rows"), [(2016, 2057), (2017, 1)])
def test_after_a_week_without_a_frame_the_record_begins_again(gap: int, rows: int) -> None:
    c, _ = taught()
    c.step(frame(40))
    decision = c.step(frame(40 + gap))
    assert len(c.state().inputs) == rows
    assert np.isfinite(decision.corrected).all(), "the models stay"


def test_models_after_an_error_without_one_are_adopted_and_used() -> None:
    c, _ = taught(("EB0C",))
    decision = c.step(frame(CALIBRATION))
    alone = [name == "EB0C" for name in THERMAL_ERRORS]
    assert np.isfinite(decision.predicted).tolist() == alone
    assert np.isfinite(decision.limits).tolist() == alone


def test_events_say_what_a_measurement_did() -> None:
    c, during = taught()
    assert during == [EventKind.TRAINING_WANTED], "a calibration corrects no model's state"
    events = c.step(frame(CALIBRATION, measured=20.0)).events
    assert events[0].kind is EventKind.STATE_UPDATE
    exceeded = [event for event in events if event.kind is EventKind.LIMIT_EXCEEDED]
    assert [(event.error, event.value, event.limit) for event in exceeded] == [(e, 18.0, 3.0) for e in THERMAL_ERRORS]
