"""What the learner's filters would reach if they were weighed in hindsight."""

import numpy as np
import pytest

from benchmarks.data import machine_days
from benchmarks.learner_bounds import bounded_predictions, ways
from studies import control
from talc.indicators import rms
from talc.settings import TalcSettings


def test_the_filters_are_those_of_the_controller() -> None:
    days = machine_days("axes", 3, 4)
    used = np.arange(len(days.truth)) % 6 == 0
    each, together, believed = bounded_predictions(days, used)
    estimate = np.where(believed > 0.5, believed * together, 0.0)
    controller = control(days, TalcSettings(method="learner"), measured=used)
    np.testing.assert_allclose(estimate, np.nan_to_num(controller.estimate), rtol=1e-9, atol=1e-9)
    assert (each.min(axis=2) <= together + 1e-9).all()
    assert (together <= each.max(axis=2) + 1e-9).all()
    assert np.abs(estimate).max() > 1.0, "something has been learnt"


def test_a_bound_is_the_least_squares_of_what_was_predicted() -> None:
    draw = np.random.default_rng(0)
    first, second = draw.normal(size=(2, 200))
    truth = np.column_stack([first, first + 2.0 * second, 0.01 * first])
    each = np.repeat(np.stack([first, second], axis=1)[:, None, :], 3, axis=1)
    together = each.mean(axis=2)
    believed = np.array([[0.9, 0.9, 0.1]] * 200)

    learner, mixture, mixture_or_zero, one_or_zero, summed = ways(truth, each, together, believed)
    assert learner[0] == pytest.approx(rms(first - 0.9 * together[:, 0]))
    assert learner[2] == pytest.approx(rms(0.01 * first)), "taken for zero"
    assert mixture[2] == pytest.approx(rms(0.01 * first - together[:, 2]))
    assert mixture_or_zero[2] == pytest.approx(rms(0.01 * first))
    assert one_or_zero[0] == pytest.approx(0.0, abs=1e-12)
    assert one_or_zero[1] == pytest.approx(min(rms(first + second), rms(2.0 * second)))
    np.testing.assert_allclose(summed, 0.0, atol=1e-9)
