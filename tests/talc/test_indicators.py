"""Indicators against values computed by hand."""

import math

import numpy as np
import pytest

from talc.indicators import Spread, first_hour_apart, p99, peak_to_peak, productivity, pv, reduction, rms, smape

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


def test_pv_is_of_the_largest_deviations_and_not_of_ranges() -> None:
    # Residuals 1, -2, 0 of an error of 10, 20, 5: 2 of 20. Ranges would give 3 of 15.
    measured = np.array([10.0, 20.0, 5.0, NAN])
    assert pv(measured, measured - np.array([1.0, -2.0, 0.0, 7.0])) == pytest.approx(10.0)
    assert pv(-measured, -measured - 2.0) == pytest.approx(10.0)
    assert pv(measured, np.array([10.0, np.inf, 5.0, 0.0])) == np.inf
    assert math.isnan(pv(np.zeros(3), np.zeros(3)))
    assert math.isnan(pv(measured, np.full(4, NAN)))
    with pytest.raises(ValueError, match="expected the same"):
        pv(np.zeros(2), np.zeros(3))


def test_p99_follows_hazens_rule() -> None:
    # Of 1..100 the rank is 99.5, half-way from 99 to 100; of 1..57 it is 56.93; of 1..11 it is 11.39, the largest.
    assert p99(-np.arange(1.0, 101.0)) == pytest.approx(99.5)
    assert p99(np.arange(57.0, 0.0, -1.0)) == pytest.approx(56.93)
    assert p99(np.append(np.arange(1.0, 12.0), NAN)) == 11.0
    assert math.isnan(p99(np.array([NAN])))


def test_smape_by_hand() -> None:
    # |2-4|/6 = 1/3, |1+1|/2 = 1, 0/0 counts as 0: mean 4/9.
    measured, predicted = np.array([2.0, 1.0, 0.0, NAN]), np.array([4.0, -1.0, 0.0, 1.0])
    assert smape(measured, predicted) == pytest.approx(400 / 9)
    assert smape(np.ones(2), np.array([1.0, np.inf])) == 50.0
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
