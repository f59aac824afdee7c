"""Indicators against values computed by hand."""

import math

import numpy as np
import pytest

from talc.indicators import Spread, first_hour_apart, p99, peak_to_peak, productivity, reduction, rms, smape

NAN = math.nan


def test_peak_to_peak_and_rms_leave_out_what_was_not_measured() -> None:
    values = np.array([3.0, NAN, -4.0, 0.0])
    assert peak_to_peak(values) == 7.0
    assert rms(values) == pytest.approx(math.sqrt(25 / 3))
    assert math.isnan(rms(np.array([NAN])))
    assert math.isnan(peak_to_peak(np.array([])))


def test_the_first_hour_and_the_rest_are_apart() -> None:
    time_s = np.array([0.0, 3599.0, 3600.0, 7200.0])
    values = np.array([[10.0, NAN], [-2.0, 1.0], [3.0, 0.0], [4.0, 5.0]])
    first, rest = first_hour_apart(time_s, values)
    assert (first.pv, rest.pv) == (12.0, 5.0), "the largest of any error, not between errors"
    assert first.rms == pytest.approx(math.sqrt(105 / 3))
    assert rest.rms == pytest.approx(math.sqrt(50 / 4))
    assert first_hour_apart(time_s, values[:, 0])[0] == Spread(12.0, math.sqrt(52.0))
    early, _ = first_hour_apart(time_s + 3600.0, values)
    assert math.isnan(early.pv)
    assert math.isnan(early.rms)


def test_p99_is_interpolated_between_magnitudes() -> None:
    # 101 magnitudes 0..100: the 99th percentile is 99; of 0..10 it lies 0.9 of the way from 9 to 10.
    assert p99(-np.arange(101.0)) == pytest.approx(99.0)
    assert p99(np.arange(11.0)) == pytest.approx(9.9)


def test_smape_by_hand() -> None:
    # |2-4|/6 = 1/3, |1+1|/2 = 1, 0/0 counts as 0: mean 4/9.
    measured, predicted = np.array([2.0, 1.0, 0.0, NAN]), np.array([4.0, -1.0, 0.0, 1.0])
    assert smape(measured, predicted) == pytest.approx(400 / 9)
    with pytest.raises(ValueError, match="expected the same"):
        smape(np.zeros(2), np.zeros(3))


def test_productivity_by_hand() -> None:
    # 30 cycles of 120 s in 48 h are 1 h: 1/48 of the time.
    assert productivity(30, 120.0, 48 * 3600.0) == pytest.approx(100 * 47 / 48)
    with pytest.raises(ValueError, match="total_s"):
        productivity(1, 120.0, 0.0)


def test_reduction_by_hand() -> None:
    assert reduction(72.7, 20.4) == pytest.approx(71.94, abs=0.01)  # EX0C of Z22
    assert reduction(2.0, 3.0) == -50.0
    assert math.isnan(reduction(0.0, 1.0))


def test_an_infinite_residual_is_not_hidden() -> None:
    assert rms(np.array([1.0, np.inf])) == np.inf
    assert peak_to_peak(np.array([1.0, np.inf, 2.0])) == np.inf
