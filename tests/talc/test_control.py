"""The controller against stand-in models whose answers are known."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from talc.control import Controller
from talc.disturbance import Disturbance
from talc.frame import Decision, Event, EventKind, FloatArray, Frame, Measurement, Phase, Why
from talc.models import ModelSet
from talc.names import THERMAL_ERRORS
from talc.settings import ControlSettings, TalcSettings, TrainingSettings
from tests.benches.control_models import INPUTS, model, models

CALIBRATION = 12


def controller() -> Controller:
    control = ControlSettings(calibration_steps=CALIBRATION, measurement_interval_steps=4, no_good_measurements=3)
    return Controller(INPUTS, TalcSettings(method="models", control=control))


def frame(k: int, warm: float = 1.0, measured: float | FloatArray | None = None) -> Frame:
    inputs = np.array([warm, 20.0])
    errors = None if measured is None else np.broadcast_to(np.asarray(measured, dtype=float), (9,)).copy()
    return Frame(k, inputs, np.isfinite(inputs), None if errors is None else Measurement(errors, np.ones(9)))


def calibrate(c: Controller, only: tuple[str, ...] = THERMAL_ERRORS) -> Decision:
    decision = None
    for k in range(CALIBRATION):
        decision = c.step(frame(k, measured=2.0))
    if decision is None or decision.training is None:
        raise ValueError("calibration asked for no training")
    c.adopt(models(decision.k, only))
    return decision


def test_calibration_asks_once_and_holds_the_whole_record() -> None:
    c = controller()
    jobs = [c.step(frame(k, measured=2.0)).training for k in range(CALIBRATION + 5)]
    asked = [job for job in jobs if job is not None]
    assert len(asked) == 1
    assert jobs[CALIBRATION - 1] is asked[0]
    assert asked[0].inputs.shape == (CALIBRATION, 2)
    assert c.phase is Phase.CALIBRATION


def test_a_sparse_calibration_measures_each_few_steps_and_ends_with_its_length() -> None:
    steps, every = 4 * CALIBRATION, 4
    c = Controller(
        INPUTS,
        TalcSettings(
            method="models", control=ControlSettings(calibration_steps=steps, calibration_interval_steps=every)
        ),
    )
    measured, asked, wanted = [], [], True
    for k in range(steps):
        measured += [k] if wanted else []
        decision = c.step(frame(k, measured=2.0 if wanted else None))
        wanted = decision.measure is Why.CALIBRATION
        asked += [k] if decision.training is not None else []
    assert measured == list(range(0, steps, every))
    assert asked == [steps - 1]


def test_a_measurement_that_a_sparse_calibration_missed_is_wanted_until_it_comes() -> None:
    control = ControlSettings(calibration_steps=4 * CALIBRATION, calibration_interval_steps=4)
    c = Controller(INPUTS, TalcSettings(method="models", control=control))
    wanted = [c.step(frame(k, measured=2.0 if k in (0, 6) else None)).measure for k in range(12)]
    assert [k for k, why in enumerate(wanted) if why is Why.CALIBRATION] == [3, 4, 5, 9, 10, 11]


def test_calibrations_too_sparse_to_learn_from_are_refused() -> None:
    with pytest.raises(ValueError, match=r"calibration_steps = 40: expected 48 or more, 12 measurements 4 apart"):
        ControlSettings(calibration_steps=40, calibration_interval_steps=4)
    with pytest.raises(ValueError, match="calibration_interval_steps = 0: expected 1 or more"):
        ControlSettings(calibration_interval_steps=0)


def test_an_error_without_a_model_chooses_its_inputs_at_the_next_training() -> None:
    training = TrainingSettings(static_inputs=True)
    control = ControlSettings(calibration_steps=CALIBRATION, measurement_interval_steps=4, no_good_measurements=3)
    c = Controller(INPUTS, TalcSettings(method="models", control=control, training=training))
    calibrate(c, THERMAL_ERRORS[:2])
    job = next(
        d.training for k in range(CALIBRATION, 60) if (d := c.step(frame(k, measured=90.0))).training is not None
    )
    assert job.static_inputs is not None
    assert job.static_inputs[0] is not None
    assert job.static_inputs[2:] == (None,) * 7


def test_settings_that_could_never_work_are_refused() -> None:
    control = ControlSettings(calibration_steps=100)
    with pytest.raises(ValueError, match="window_steps = 99: expected calibration_steps = 100 or more"):
        TalcSettings(method="models", control=control, training=TrainingSettings(window_steps=99))
    with pytest.raises(ValueError, match="policy = 'uncertainty': expected 'fixed' or 'novelty' with selector 'pso'"):
        TalcSettings(
            method="models", control=ControlSettings(policy="uncertainty"), training=TrainingSettings(selector="pso")
        )
    with pytest.raises(ValueError, match="calibration_interval_steps = 2: expected 1 with selector 'tck'"):
        TalcSettings(
            method="models",
            control=ControlSettings(calibration_interval_steps=2),
            training=TrainingSettings(selector="tck"),
        )


def test_too_few_measurements_prolong_calibration() -> None:
    c = controller()
    jobs = [c.step(frame(k, measured=2.0 if k % 2 else None)).training for k in range(2 * CALIBRATION)]
    first = next(k for k, job in enumerate(jobs) if job is not None)
    assert first == 17  # the ninth measurement, 0.75 of twelve


def test_a_training_without_a_model_keeps_calibrating_and_says_so() -> None:
    c = controller()
    for k in range(CALIBRATION):
        c.step(frame(k, measured=2.0))
    events = c.adopt(models(CALIBRATION - 1, only=()))
    assert [e.kind for e in events] == [EventKind.MODEL_REJECTED]
    assert c.step(frame(CALIBRATION, measured=2.0)).measure is Why.CALIBRATION
    later = [c.step(frame(k, measured=2.0)).training for k in range(CALIBRATION + 1, 2 * CALIBRATION)]
    assert [i for i, job in enumerate(later, 2) if job is not None] == [9], "counted again: 0.75 of twelve"


def test_predicts_at_the_model_s_equilibrium_and_asks_at_the_interval() -> None:
    c = controller()
    calibrate(c)
    decisions = [c.step(frame(CALIBRATION + i)) for i in range(5)]
    assert np.allclose([d.corrected for d in decisions], 2.0)
    assert [d.measure for d in decisions] == [None, None, Why.INTERVAL, Why.INTERVAL, Why.INTERVAL]


def test_a_residual_above_the_limit_leads_through_no_good_to_a_training() -> None:
    c = controller()
    calibrate(c)
    k = CALIBRATION
    inside = c.step(frame(k, measured=4.9))
    assert inside.phase is Phase.COMPENSATION
    outside = c.step(frame(k + 1, measured=20.0))
    assert outside.phase is Phase.NO_GOOD
    assert outside.measure is Why.NO_GOOD
    after = [c.step(frame(k + 2 + i, measured=20.0)) for i in range(4)]
    assert [d.training is not None for d in after] == [False, False, True, False]
    c.adopt(models(k + 4))
    assert c.phase is Phase.COMPENSATION


def test_an_error_without_a_model_is_held_at_its_last_measurement() -> None:
    c = controller()
    calibrate(c, only=("EY0A",))
    measured = np.full(9, 2.0)
    measured[3] = 7.0
    c.step(frame(CALIBRATION, measured=measured))
    decision = c.step(frame(CALIBRATION + 1))
    assert decision.corrected[3] == 7.0
    assert np.isnan(decision.predicted[3])


def test_substitution_is_reported_once_when_it_begins_and_once_when_it_ends() -> None:
    c = controller()
    calibrate(c)
    warm = [1.0, np.nan, np.nan, 1.0, 1.0]
    decisions = [c.step(frame(CALIBRATION + i, warm=w)) for i, w in enumerate(warm)]
    told = [sum(e.kind is EventKind.INPUT_SUBSTITUTED for e in d.events) for d in decisions]
    assert told == [0, 1, 0, 1, 0]
    assert [d.substituted for d in decisions] == [(), ("warm",), ("warm",), (), ()]
    assert np.allclose(decisions[2].corrected, 2.0)


def test_a_gap_longer_than_the_training_window_is_bridged() -> None:
    control = ControlSettings(calibration_steps=CALIBRATION)
    c = Controller(INPUTS, TalcSettings(method="models", control=control, training=TrainingSettings(window_steps=12)))
    calibrate(c)
    decision = c.step(frame(CALIBRATION + 500))
    assert np.allclose(decision.corrected, 2.0)
    assert decision.measure is Why.INTERVAL


@settings(max_examples=30)
@given(st.data())
def test_no_mask_gap_or_partial_measurement_makes_a_correction_that_is_not_finite(data: st.DataObject) -> None:
    c = controller()
    calibrate(c)
    number = st.sampled_from([np.nan, np.inf, -50.0, 1.0, 1e9])
    k = CALIBRATION - 1
    for _ in range(data.draw(st.integers(1, 12))):
        k += data.draw(st.sampled_from([1, 1, 2, 30, 5000]))
        inputs = np.array(data.draw(st.lists(number, min_size=2, max_size=2)))
        valid = np.array(data.draw(st.lists(st.booleans(), min_size=2, max_size=2)))
        errors = data.draw(st.none() | st.lists(st.sampled_from([np.nan, 1.0, 40.0]), min_size=9, max_size=9))
        measurement = None if errors is None else Measurement(np.array(errors), np.ones(9))
        decision = c.step(Frame(k, inputs, valid, measurement))
        assert np.isfinite(decision.corrected).all()
        if decision.training is not None:
            c.adopt(models(k))


def policy(name: str) -> Controller:
    control = ControlSettings(
        calibration_steps=CALIBRATION,
        policy=name,  # type: ignore[arg-type]
        shortest_interval_steps=3,
        longest_interval_steps=30,
        no_good_measurements=3,
    )
    return Controller(INPUTS, TalcSettings(method="models", control=control))


def drifting(limit: float = 3.0) -> ModelSet:
    """Models with a known drift and known training inputs: leverage (warm - 0)² up to 4."""
    d = Disturbance(0.1, np.array([1.0]), np.array([0.3]), np.zeros(1))
    one = [
        replace(model(e, limit), disturbance=d, leverage=np.eye(2), leverage_limit=32.0, novelty_std=0.1)
        for e in THERMAL_ERRORS
    ]
    return ModelSet(k=CALIBRATION - 1, why="calibration", input_names=INPUTS, models=tuple(one))


def wanted(c: Controller, steps: int, warm: float = 1.0) -> list[Why | None]:
    for k in range(CALIBRATION):
        c.step(frame(k, measured=2.0))
    c.adopt(drifting())
    return [c.step(frame(CALIBRATION + i, warm=warm)).measure for i in range(steps)]


def test_the_uncertainty_policy_asks_when_the_interval_nears_the_limit() -> None:
    asked = wanted(policy("uncertainty"), 40)
    first = next(i for i, why in enumerate(asked) if why is not None)
    assert asked[first] is Why.UNCERTAINTY
    # A random walk of 0.3 per step fills 0.75 of a limit of 3 when 1.96 sqrt(0.09 n + 0.01) > 2.25.
    assert first + 1 == int(np.ceil(((2.25 / 1.96) ** 2 - 0.01) / 0.09))


def test_the_novelty_policy_asks_when_inputs_leave_training_and_at_the_longest_interval() -> None:
    familiar = wanted(policy("novelty"), 40)
    assert familiar.index(Why.INTERVAL) == 28  # 30 steps after the last measurement, asked one step ahead
    assert set(familiar[28:]) == {Why.INTERVAL}, "until it comes"
    assert Why.NOVELTY not in familiar
    strange = wanted(policy("novelty"), 40, warm=9.0)
    assert strange.index(Why.NOVELTY) == 1  # not sooner than 3 steps after the last measurement


def whole_settings() -> TalcSettings:
    control = ControlSettings(calibration_steps=CALIBRATION, measurement_interval_steps=4, no_good_measurements=3)
    return TalcSettings(method="models", control=control)


def kinds(events: tuple[Event, ...]) -> list[EventKind]:
    return [event.kind for event in events]


def test_a_change_of_phase_is_an_event_and_no_other_training_is() -> None:
    c = controller()
    calibrate(c)
    outside = c.step(frame(CALIBRATION, measured=20.0))
    changed = [e.values for e in outside.events if e.kind is EventKind.PHASE_CHANGED]
    assert changed == [{"phase": Phase.COMPENSATION.value, "next": Phase.NO_GOOD.value}]
    after = [c.step(frame(CALIBRATION + 1 + i, measured=20.0)) for i in range(4)]
    assert [d.measure for d in after] == [Why.NO_GOOD, Why.NO_GOOD, None, None], "none while a training is in progress"
    found = c.adopt(models(CALIBRATION + 4))
    changed = [e.values for e in found if e.kind is EventKind.PHASE_CHANGED]
    assert changed == [{"phase": Phase.NO_GOOD.value, "next": Phase.COMPENSATION.value}]
    assert EventKind.PHASE_CHANGED not in kinds(c.adopt(models(CALIBRATION + 4)))


def test_an_update_interval_trains_in_compensation_on_the_grid_and_ends_no_other_phase() -> None:
    control = ControlSettings(
        calibration_steps=CALIBRATION,
        measurement_interval_steps=4,
        no_good_measurements=3,
        update_interval_steps=10,
    )
    c = Controller(INPUTS, TalcSettings(method="models", control=control))
    calibrate(c)
    jobs = {}
    for k in range(CALIBRATION, 45):
        job = c.step(frame(k, measured=2.0 if k % 4 == 0 else None)).training
        if job is not None:
            jobs[k] = job.why
            c.adopt(models(k))
    assert jobs == {20: Why.INTERVAL, 30: Why.INTERVAL, 40: Why.INTERVAL}
    # A residual beyond its limit while such a training is in progress: its end does not end the no-good phase.
    for k in range(45, 51):
        job = c.step(frame(k)).training
    assert job is not None
    phases = [c.phase]
    c.step(frame(51, measured=20.0))
    phases.append(c.phase)
    c.adopt(replace(models(50), why=Why.INTERVAL.value))
    phases.append(c.phase)
    why = [None if job is None else job.why for job in (c.step(frame(k, measured=20.0)).training for k in (52, 53, 54))]
    assert why == [None, None, Why.NO_GOOD]
    c.adopt(models(54))
    phases.append(c.phase)
    assert phases == [Phase.COMPENSATION, Phase.NO_GOOD, Phase.NO_GOOD, Phase.COMPENSATION]


def test_a_training_gets_the_last_rows_of_its_window() -> None:
    training = TrainingSettings(window_steps=CALIBRATION)
    c = Controller(INPUTS, replace(whole_settings(), training=training))
    calibrate(c)
    steps = range(CALIBRATION, CALIBRATION + 8)
    jobs = [c.step(frame(k, warm=float(k), measured=90.0)).training for k in steps]
    job = next(job for job in jobs if job is not None)
    assert len(c.state().inputs) > CALIBRATION
    assert job.inputs.shape == job.valid.shape == (CALIBRATION, 2)
    assert job.measured.shape == (CALIBRATION, 9)
    asked = job.k - CALIBRATION + 1  # rows of this series; the others are the calibration's
    assert job.inputs[-asked:, 0].tolist() == [float(k) for k in range(CALIBRATION, job.k + 1)]


def test_through_a_gap_the_models_run_as_they_would_on_held_inputs() -> None:
    gap, held = controller(), controller()
    for c in (gap, held):
        calibrate(c)
        c.step(frame(CALIBRATION, warm=5.0))  # from here on they approach 10
    for k in range(CALIBRATION + 1, CALIBRATION + 3):
        held.step(frame(k, warm=np.nan))
    a, b = (c.step(frame(CALIBRATION + 3, warm=5.0)) for c in (gap, held))
    np.testing.assert_array_equal(a.predicted, b.predicted)
    assert 2.0 < a.predicted[0] < 10.0
    np.testing.assert_array_equal(gap.state().inputs, held.state().inputs)


@pytest.mark.parametrize("k", [3, 1000, 70000])
def test_an_index_that_is_not_above_the_last_one_is_refused(k: int) -> None:
    c = controller()
    c.step(frame(70000))
    with pytest.raises(ValueError, match=f"k = {k}: expected more than 70000, the last frame's"):
        c.step(frame(int(str(k))))


def test_with_fewer_measurements_asked_for_after_a_restart_the_training_begins_at_the_next() -> None:
    c = controller()
    calibrate(c)
    for k in range(CALIBRATION, CALIBRATION + 3):
        c.step(frame(k, measured=20.0))
    few = replace(whole_settings().control, no_good_measurements=1)
    again = Controller.restore(c.state(), replace(whole_settings(), control=few))
    assert again.step(frame(CALIBRATION + 3, measured=20.0)).training is not None


def test_after_a_pause_of_unknown_length_a_measurement_is_due_by_the_first_step() -> None:
    control = replace(whole_settings().control, measurement_interval_steps=20)
    c = Controller(INPUTS, replace(whole_settings(), control=control))
    calibrate(c)
    asked = [c.step(replace(frame(k), pause_unknown=k == CALIBRATION)).measure for k in range(CALIBRATION, 22)]
    assert [CALIBRATION + i for i, why in enumerate(asked) if why is Why.INTERVAL] == [19, 20, 21]


@pytest.mark.parametrize(("acl", "limits"), [("fixed", (7.0, 8.0)), ("training", (4.0, 4.0)), ("adaptive", (3.0, 3.0))])
def test_the_limits_are_those_of_the_setting(acl: str, limits: tuple[float, float]) -> None:
    """limits: that of an error in µm, and that of one in µm/m"""
    control = replace(whole_settings().control, acl=acl, acl_fixed_um=7.0, acl_fixed_um_per_m=8.0)  # type: ignore[arg-type]
    c = Controller(INPUTS, replace(whole_settings(), control=control))
    calibrate(c)
    known = tuple(replace(model(e, 3.0), training_limit=4.0) for e in THERMAL_ERRORS)
    c.adopt(replace(models(CALIBRATION), models=known))
    found = dict(zip(THERMAL_ERRORS, c.step(frame(CALIBRATION)).limits, strict=True))
    assert (found["EY0A"], found["EA0C"]) == limits
