"""Parts of the controller's steps: gaps, errors with and without a model, and what its events say."""

from dataclasses import replace

import numpy as np
import pytest

from talc.control import Controller, ControllerState
from talc.frame import EventKind, FloatArray, Frame, Measurement, TrainingJob
from talc.kinds import EventCode
from talc.models import ModelSet
from talc.names import THERMAL_ERRORS
from talc.settings import ControlSettings, TalcSettings, TrainingSettings
from tests.benches.control_models import INPUTS, model, models

CALIBRATION = 12


def frame(k: int, measured: float | None = None) -> Frame:
    errors = None if measured is None else Measurement(np.full(9, measured), np.ones(9))
    return Frame(k, np.array([1.0, 20.0]), np.ones(2, dtype=np.bool_), errors)


def taught(
    only: tuple[str, ...] = THERMAL_ERRORS, training: TrainingSettings | None = None
) -> tuple[Controller, list[EventKind]]:
    """With models, and what happened during the calibration."""
    control = ControlSettings(calibration_steps=CALIBRATION, measurement_interval_steps=4, no_good_measurements=3)
    c = Controller(INPUTS, TalcSettings(method="models", control=control, training=training or TrainingSettings()))
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


def on(name: str, k: int) -> ModelSet:
    """Models of all errors with this input alone."""
    return replace(models(k), models=tuple(replace(model(error), inputs=(name,)) for error in THERMAL_ERRORS))


def test_after_a_pause_of_unknown_length_the_record_begins_again() -> None:
    c, _ = taught()
    decision = c.step(replace(frame(CALIBRATION), pause_unknown=True))
    assert len(c.state().inputs) == 1
    assert np.isfinite(decision.corrected).all(), "the models stay"


@pytest.mark.parametrize("name", ["inputs", "valid", "measured", "held"])
def test_what_is_done_with_a_state_changes_neither_its_controller_nor_the_restored_one(name: str) -> None:
    c, _ = taught()
    state = c.state()

    def array(of: ControllerState) -> FloatArray:
        found: FloatArray = getattr(of.strategy if name == "held" else of, name)
        return found

    before = np.copy(array(state))
    again = Controller.restore(state, TalcSettings(method="models"))
    array(state)[:] = 0
    np.testing.assert_array_equal(array(c.state()), before)
    np.testing.assert_array_equal(array(again.state()), before)
    assert before.any()


def test_an_input_that_no_model_uses_any_more_is_not_reported_as_good_again() -> None:
    c, _ = taught()
    began = c.step(replace(frame(CALIBRATION), valid=np.array([False, True]))).events
    assert [(event.code, event.values) for event in began] == [(EventCode.LAST_VALUE_USED, {"input": "warm"})]
    c.adopt(on("idle", CALIBRATION))
    assert c.step(replace(frame(CALIBRATION + 1), valid=np.array([False, True]))).events == ()


def test_models_trained_on_the_same_inputs_in_another_order_are_refused() -> None:
    c, _ = taught()
    with pytest.raises(ValueError, match="other inputs"):
        c.adopt(replace(models(CALIBRATION), input_names=INPUTS[::-1]))


def test_static_inputs_stay_those_that_were_chosen_first() -> None:
    c, _ = taught(training=TrainingSettings(static_inputs=True))
    c.adopt(on("idle", CALIBRATION))
    jobs = [c.step(frame(k, measured=90.0)).training for k in range(CALIBRATION, CALIBRATION + 10)]
    asked: list[TrainingJob] = [job for job in jobs if job is not None]
    assert [job.static_inputs for job in asked] == [(("warm",),) * 9]
