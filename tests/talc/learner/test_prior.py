"""What a second machine of the same kind gains from the first ones, and what a wrong prior costs."""

import json
from dataclasses import replace

import numpy as np
import pytest

from talc.control import Controller
from talc.frame import FloatArray, Frame, Measurement
from talc.learner import Prior, make_prior
from talc.settings import TalcSettings
from tests.benches.thermal_series import ThermalSeries, series

SETTINGS = TalcSettings(method="learner")


def machine(seed: int) -> ThermalSeries:
    """A machine of one kind: the same physics under other loads."""
    made = series(288, seed)
    return replace(made, truth=made.truth - made.truth[0], measured=made.measured - made.truth[0])


def run(days: ThermalSeries, prior: Prior | None = None) -> tuple[Controller, FloatArray]:
    """The error that it leaves, with a measurement every 55 min."""
    controller, left = Controller(days.names, SETTINGS, prior=prior), []
    for k, row in enumerate(days.inputs):
        measurement = Measurement(days.measured[k], np.full(9, 0.5)) if k % 11 == 0 else None
        decision = controller.step(Frame(k, row, np.isfinite(row), measurement))
        left.append(days.truth[k] - np.nan_to_num(decision.predicted))
    return controller, np.array(left)


def rms(left: FloatArray) -> float:
    return float(np.sqrt(np.mean(left**2)))


@pytest.fixture(scope="module")
def prior() -> Prior:
    learnt = []
    for seed in range(10, 14):
        days = machine(seed)
        course = run(days)[0].state().course
        assert course is not None
        learnt.append((days.names, course.learner))
    return make_prior(learnt)


@pytest.mark.slow
def test_a_second_machine_of_a_kind_starts_nearly_where_the_first_ones_are(prior: Prior) -> None:
    without, told = (run(machine(20), p)[1] for p in (None, prior))
    assert rms(told[:72]) < 0.75 * rms(without[:72])
    assert rms(told[72:]) < rms(without[72:])


def without_the_ninth(days: ThermalSeries) -> ThermalSeries:
    """The same, while EC0C stays zero."""
    truth = days.truth.copy()
    truth[:, 8] = 0.0
    return replace(days, truth=truth, measured=days.measured - days.truth + truth)


@pytest.mark.slow
def test_an_error_that_was_zero_on_other_machines_is_not_believed_in_on_the_next() -> None:
    learnt = []
    for seed in range(10, 13):
        days = without_the_ninth(machine(seed))
        course = run(days)[0].state().course
        assert course is not None
        learnt.append((days.names, course.learner))
    told = make_prior(learnt)
    assert told.machines.tolist() == [3.0] * 8 + [0.0]
    left = run(without_the_ninth(machine(20)), told)[1]
    assert rms(left[:, 8]) < 0.05
    some = [learnt[0], (learnt[1][0], run(machine(11))[0].state().course.learner)]  # type: ignore[union-attr]
    assert make_prior(some).machines[8] == 2, "half of them believe in it"


@pytest.mark.parametrize("wrong", ["mirrored", "exchanged"])
def test_a_wrong_prior_is_forgotten_within_hours(prior: Prior, wrong: str) -> None:
    false = replace(prior, mean=-prior.mean) if wrong == "mirrored" else replace(prior, inputs=prior.inputs[::-1])
    without, told = (run(machine(21), p)[1] for p in (None, false))
    assert rms(told[144:]) < 1.1 * rms(without[144:])


def test_it_comes_back_from_json(prior: Prior) -> None:
    again = Prior.from_dict(json.loads(json.dumps(prior.to_dict())))
    assert again.inputs == prior.inputs
    np.testing.assert_allclose(again.mean, prior.mean, rtol=1e-6)
    np.testing.assert_allclose(again.covariance, prior.covariance, rtol=1e-6)


def test_inputs_are_matched_by_name_and_others_keep_a_flat_prior(prior: Prior) -> None:
    span, told = prior.of(["new", "t3"])
    assert np.isnan(span[0])
    assert not told.mean[:, :5].any()
    assert not told.covariance[:, :5].any()
    np.testing.assert_array_equal(told.mean[:, 5:], prior.mean[:, 15:20])
    days = machine(22)
    more = replace(days, names=("new", *days.names[1:]))
    assert rms(run(more, prior)[1][144:]) < 0.5 * rms(days.truth[144:])


def test_a_file_of_another_format_is_refused(prior: Prior) -> None:
    with pytest.raises(ValueError, match="format = 2: expected 1"):
        Prior.from_dict({**prior.to_dict(), "format": 2})
    with pytest.raises(ValueError, match="span: expected a list of 12 numbers"):
        Prior.from_dict({**prior.to_dict(), "span": [3.0]})


def test_machines_that_have_learnt_nothing_make_no_prior() -> None:
    days = machine(23)
    course = Controller(days.names, SETTINGS).state().course
    assert course is not None
    with pytest.raises(
        ValueError, match="no error was measured 12 times and found to be more than zero by most of 1 machines"
    ):
        make_prior([(days.names, course.learner)])
