"""The whole learner behind the controller: from the first hour, through gaps, failures and restarts."""

from dataclasses import replace

import numpy as np
import pytest

from talc.control import Controller
from talc.frame import Decision, EventKind, FloatArray, Frame, Measurement, Phase, Why
from talc.settings import LearnerSettings, TalcSettings
from tests.benches.thermal_series import ThermalSeries, series, without_ninth

SETTINGS = TalcSettings(method="learner")
SIGMA = np.full(9, 0.5)
FIELDS = ("predicted", "corrected", "sigma", "limits", "trusted")


@pytest.fixture(scope="module")
def days() -> ThermalSeries:
    """Two days; the ninth error is zero."""
    return without_ninth(series(576, 3))


def step(controller: Controller, days: ThermalSeries, k: int, at: int, measured: bool) -> Decision:
    measurement = Measurement(days.measured[k], SIGMA) if measured else None
    return controller.step(Frame(at, days.inputs[k], np.isfinite(days.inputs[k]), measurement))


def run(days: ThermalSeries, every: int = 11, rows: range | None = None) -> tuple[Controller, list[Decision]]:
    controller = Controller(days.names, SETTINGS)
    rows = rows or range(len(days.inputs))
    return controller, [step(controller, days, k, k, k % every == 0) for k in rows]


def rms(values: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)))


def test_compensation_begins_with_the_first_measurement_and_soon_is_better_than_none(days: ThermalSeries) -> None:
    _, decisions = run(days)
    assert decisions[0].phase is Phase.COMPENSATION
    left = days.truth - np.array([d.predicted for d in decisions])
    assert (rms(left[72:288]) < 0.6 * rms(days.truth[72:288]))[:8].all()
    assert (rms(left[288:]) < 0.4 * rms(days.truth[288:]))[:8].all()


def test_an_error_that_is_only_noise_stays_untouched(days: ThermalSeries) -> None:
    _, decisions = run(days)
    assert not any(d.trusted[8] for d in decisions[24:])
    assert rms(np.array([d.corrected[8] for d in decisions])) < 0.1


def test_95_percent_intervals_hold_the_truth(days: ThermalSeries) -> None:
    _, decisions = run(days)
    off = np.abs(days.truth - np.array([d.corrected for d in decisions]))[:, :8]
    inside = off <= 1.96 * np.array([d.sigma for d in decisions])[:, :8]
    assert inside[24:].mean() > 0.9


@pytest.mark.parametrize("measured", [False, True])
def test_a_step_later_the_correction_is_what_the_next_frame_predicts(days: ThermalSeries, measured: bool) -> None:
    controller, _ = run(days, rows=range(300))
    for k in range(300, 320):
        inputs, valid = days.inputs[k], np.isfinite(days.inputs[k])
        between = controller.between(inputs, valid, 1.0)
        predicted = step(controller, days, k, k, measured).predicted
        assert between == pytest.approx(predicted, rel=1e-9, abs=1e-9)


def test_looking_between_two_steps_changes_no_decision(days: ThermalSeries) -> None:
    whole, _ = run(days, rows=range(200))
    again = Controller.restore(whole.state(), SETTINGS)
    for k in range(200, 300):
        for steps in (0.1, 0.9):
            again.between(days.inputs[k] + 1.0, np.ones(len(days.names), dtype=np.bool_), steps)
        a, b = (step(c, days, k, k, k % 24 == 0) for c in (whole, again))
        for name in FIELDS:
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def test_between_two_steps_an_input_that_cannot_be_judged_counts_as_before(days: ThermalSeries) -> None:
    controller, _ = run(days, rows=range(300))
    inputs, valid = days.inputs[299].copy(), np.ones(len(days.names), dtype=np.bool_)
    usual = controller.between(inputs, valid, 0.5)
    jumped = days.inputs[299][0] - 40.0
    for value in (np.nan, 1e300, 12000.0, jumped):  # not read; no possible value; further than ever before
        inputs[0] = value
        assert controller.between(inputs, valid, 0.5) == pytest.approx(usual)
    inputs[0], valid[0] = days.inputs[299][0] + 5.0, False
    assert controller.between(inputs, valid, 0.5) == pytest.approx(usual)
    valid[0] = True
    assert controller.between(inputs, valid, 0.5) != pytest.approx(usual)
    without = valid.copy()
    without[0] = False
    controller.step(Frame(300, days.inputs[299], without))
    kept = controller.between(days.inputs[299], without, 0.5)
    assert controller.between(inputs, valid, 0.5) == pytest.approx(kept), "it may be another sensor"


def test_before_the_first_frame_nothing_is_corrected_between_and_before_the_first_measurement_nothing_is_known(
    days: ThermalSeries,
) -> None:
    controller, valid = Controller(days.names, SETTINGS), np.ones(len(days.names), dtype=np.bool_)
    assert controller.between(days.inputs[0], valid, 0.5) is None
    step(controller, days, 0, 0, measured=False)
    unknown = controller.between(days.inputs[0], valid, 0.5)
    assert unknown is not None
    assert np.isnan(unknown).all()
    assert Controller(days.names, TalcSettings(method="models")).between(days.inputs[0], valid, 0.5) is None


@pytest.mark.parametrize("gap", [5, 144, 4032])
def test_after_a_gap_it_goes_on_with_a_larger_sigma_and_asks_at_once(days: ThermalSeries, gap: int) -> None:
    controller, before = run(days, rows=range(289))
    after = step(controller, days, 300, 289 + gap, False)
    assert np.isfinite(after.corrected).all()
    assert (after.sigma[:8] >= before[-1].sigma[:8]).all()
    assert after.measure is (Why.NOVELTY if gap > 12 else None)
    later = [step(controller, days, 300 + i, 289 + gap + i, i == 1) for i in range(1, 30)]
    left = days.truth[302:330] - np.array([d.corrected for d in later[1:]])
    assert (rms(left) < 0.6 * rms(days.truth[302:330]) + 0.5)[:8].all()


def test_a_machine_that_is_off_at_night_is_compensated_by_day(days: ThermalSeries) -> None:
    controller, left = Controller(days.names, SETTINGS), []
    for k in range(576):
        if k % 288 >= 96:
            continue  # off for 16 hours a day
        left.append(days.truth[k] - step(controller, days, k, k, k % 12 == 0).predicted)
    second = np.array(left)[100:]
    share = rms(second)[:8] / rms(days.truth[292:384])[:8]
    assert share.mean() < 0.35
    assert share.max() < 0.6


def test_a_failed_sensor_widens_sigma_and_does_not_throw_the_estimate(days: ThermalSeries) -> None:
    controller, _ = run(days, rows=range(400))
    other = Controller.restore(controller.state(), SETTINGS)
    inputs, valid = days.inputs[400].copy(), np.ones(12, dtype=np.bool_)
    whole = other.step(Frame(400, inputs, valid))
    inputs[0], valid[0] = np.nan, False
    without = controller.step(Frame(400, inputs, valid))
    assert without.substituted == ("t0",)
    assert without.sigma[0] > whole.sigma[0]
    assert without.sigma[1] == pytest.approx(whole.sigma[1], rel=0.2)
    assert [e.kind for e in without.events] == [EventKind.INPUT_SUBSTITUTED]
    assert abs(without.corrected[0] - whole.corrected[0]) < 3.0 * without.sigma[0]


def test_an_input_that_first_moves_after_a_day_does_not_throw_the_estimate(days: ThermalSeries) -> None:
    inputs = days.inputs.copy()
    inputs[:, 11] = 0.0
    inputs[400:, 11] = 12000.0
    _, decisions = run(replace(days, inputs=inputs))
    change = decisions[400].corrected - decisions[399].corrected
    assert (np.abs(change) < 5.0).all()
    assert (decisions[400].sigma > decisions[399].sigma)[:8].all()


def test_the_policy_asks_by_its_limits(days: ThermalSeries) -> None:
    counts = []
    for limit in (3.0, 6.0):
        settings = TalcSettings(method="learner", learner=LearnerSettings(limit_um=limit, limit_um_per_m=2 * limit))
        controller, asked, count, since = Controller(days.names, settings), True, 0, []
        for k in range(576):
            decision = step(controller, days, k, k, asked)
            count += asked
            since += [k] if asked else []
            asked = decision.measure is not None
        counts.append(count)
        apart = np.diff(since)
        assert limit > 3.0 or apart[0] < 4, "nothing has been learnt from only the reference"
        assert apart[1:].min() >= 4
        assert np.diff(since).max() <= 48
    assert counts[0] > counts[1]


def test_after_a_no_good_phase_the_shortest_interval_holds(days: ThermalSeries) -> None:
    settings = LearnerSettings(limit_um=1.5, limit_um_per_m=3.0, no_good_measurements=2)
    controller, asked, phases, measured = (
        Controller(days.names, TalcSettings(method="learner", learner=settings)),
        True,
        [],
        [],
    )
    for k in range(576):
        measured += [k] if asked else []
        decision = step(controller, days, k, k, asked)
        phases.append(decision.phase)
        asked = decision.measure is not None
    left = [k for k in range(1, 576) if (phases[k - 1], phases[k]) == (Phase.NO_GOOD, Phase.COMPENSATION)]
    apart = [min(later) - k for k in left if (later := [each for each in measured if each > k])]
    assert len(apart) > 2
    assert min(apart) >= settings.shortest_interval_steps


def test_contributions_add_up_to_the_estimate(days: ThermalSeries) -> None:
    controller, decisions = run(days, rows=range(300))
    why = controller.explain()
    assert why is not None
    np.testing.assert_allclose(why.inputs.sum(axis=1) + why.level, decisions[-1].corrected, atol=1e-9)
    np.testing.assert_allclose(why.experts.sum(axis=1), 1.0)
    # Each error answers its own input and the third one after it.
    assert np.abs(why.inputs[0]).argmax() in (0, 3)
