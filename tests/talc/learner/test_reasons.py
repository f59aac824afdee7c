"""The learner's reasons: contributions, weights, and how its expectations come true."""

from dataclasses import replace

import numpy as np
import pytest

from talc.control import Controller
from talc.frame import Decision, Frame, Measurement, Why
from talc.learner import make_prior
from talc.learner.reasons import KINDS
from talc.settings import LearnerSettings, TalcSettings
from tests.benches.thermal_series import ThermalSeries, series, without_ninth

SIGMA = np.full(9, 0.5)
GOOD = np.ones(12, dtype=np.bool_)


@pytest.fixture(scope="module")
def days() -> ThermalSeries:
    """A day; the ninth error is zero."""
    return without_ninth(series(288, 3))


def after_a_day(days: ThermalSeries, **settings: object) -> tuple[Controller, Decision]:
    chosen = replace(LearnerSettings(), **settings)  # type: ignore[arg-type]
    controller = Controller(days.names, TalcSettings(method="learner", learner=chosen))
    for k, row in enumerate(days.inputs):
        measurement = Measurement(days.measured[k], SIGMA) if k % 11 == 0 else None
        decision = controller.step(Frame(k, row, GOOD, measurement))
    return controller, decision


def test_parts_add_up_to_the_estimate_and_the_right_inputs_are_named(days: ThermalSeries) -> None:
    controller, decision = after_a_day(days)
    reasons = controller.reasons()
    assert reasons is not None
    assert reasons.k == 287
    for j, reason in enumerate(reasons.errors):
        whole = sum(value for _, value in reason.inputs) + reason.other_inputs + reason.level
        assert whole == pytest.approx(decision.corrected[j], abs=1e-9)
        assert reason.trusted == decision.trusted[j]
        assert sum(share for _, share in reason.experts) == pytest.approx(1.0)
        sizes = [abs(value) for _, value in reason.inputs]
        assert sizes == sorted(sizes, reverse=True)
    # The first error answers the first input and the fourth one.
    assert {name for name, _ in reasons.errors[0].inputs[:2]} <= {"t0", "t3"}
    assert reasons.errors[0].experts[0][0] == "chosen inputs"


def test_an_error_that_is_not_corrected_is_moved_by_nothing(days: ThermalSeries) -> None:
    controller, _ = after_a_day(days)
    reasons = controller.reasons()
    assert reasons is not None
    silent = reasons.errors[8]
    assert (silent.trusted, silent.inputs, silent.estimate, silent.level) == (False, (), 0.0, 0.0)
    assert silent.believed < 0.5
    assert silent.expected_sigma > 0.0


@pytest.mark.parametrize("limit", [2.0, 3.0, 50.0])
def test_the_next_measurement_comes_when_and_as_it_was_expected_while_inputs_stay(
    days: ThermalSeries, limit: float
) -> None:
    controller, decision = after_a_day(days, limit_um=limit, limit_um_per_m=limit)
    reasons = controller.reasons()
    assert reasons is not None
    k = 287
    while decision.measure is None:
        k += 1
        decision = controller.step(Frame(k, days.inputs[-1], GOOD))
    assert k + 1 == reasons.next_k
    assert decision.measure is reasons.next_why
    decision = controller.step(Frame(k + 1, days.inputs[-1], GOOD))
    np.testing.assert_allclose([e.expected for e in reasons.errors], decision.predicted, atol=1e-9)
    np.testing.assert_allclose([e.expected_sigma for e in reasons.errors], decision.sigma, atol=1e-9)


def test_a_fixed_interval_says_when(days: ThermalSeries) -> None:
    controller, _ = after_a_day(days, policy="fixed", measurement_interval_steps=30)
    reasons = controller.reasons()
    assert reasons is not None
    assert (reasons.next_k, reasons.next_why) == (286 + 30, Why.INTERVAL)


def test_before_the_first_measurement_nothing_is_known_but_that_it_is_wanted(days: ThermalSeries) -> None:
    controller = Controller(days.names, TalcSettings(method="learner"))
    assert controller.reasons() is None
    controller.step(Frame(0, days.inputs[0], GOOD))
    reasons = controller.reasons()
    assert reasons is not None
    assert (reasons.next_k, reasons.next_why) == (1, Why.CALIBRATION)
    assert all(np.isnan(e.estimate) and not e.trusted for e in reasons.errors)


def test_experts_of_a_prior_are_a_kind_of_their_own_and_models_give_no_reasons(days: ThermalSeries) -> None:
    state = after_a_day(days)[0].state().course
    assert state is not None
    told = Controller(days.names, TalcSettings(method="learner"), prior=make_prior([(days.names, state.learner)]))
    told.step(Frame(0, days.inputs[0], GOOD, Measurement(days.measured[0], SIGMA)))
    reasons = told.reasons()
    assert reasons is not None
    assert {kind for kind, _ in reasons.errors[0].experts} == set(KINDS)
    models = Controller(days.names, TalcSettings(method="models"))
    models.step(Frame(0, days.inputs[0], GOOD))
    assert models.reasons() is None


def test_asking_changes_no_later_decision(days: ThermalSeries) -> None:
    asked, silent = after_a_day(days)[0], after_a_day(days)[0]
    for k in range(288, 300):
        asked.reasons()
        a, b = (c.step(Frame(k, days.inputs[k - 200], GOOD)) for c in (asked, silent))
        np.testing.assert_array_equal(a.corrected, b.corrected)
        np.testing.assert_array_equal(a.sigma, b.sigma)
