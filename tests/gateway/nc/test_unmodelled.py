"""How long an error without a model is corrected by its last measurement. Times are arguments."""

import math
from dataclasses import replace

import numpy as np
import pytest

from gateway.nc.unmodelled import LastMeasured
from talc.frame import Decision, Measurement
from tests.benches.nc_link_bench import decision

UNKNOWN = -math.inf


def without_models(*modelled: int) -> Decision:
    """The errors with these numbers have a model."""
    predicted = np.full(9, math.nan)
    predicted[list(modelled)] = 0.0
    return replace(decision(0.0), predicted=predicted)


def known(last: LastMeasured, now_s: float, *modelled: int) -> list[int]:
    """Numbers of the errors that are corrected."""
    return np.flatnonzero(~last.outdated(without_models(*modelled), now_s)).tolist()


def test_each_counts_from_its_own_measurement_and_one_with_a_model_always() -> None:
    last = LastMeasured(100.0, [0.0, 50.0, UNKNOWN, *[0.0] * 6])
    assert known(last, 100.0) == [0, 1, 3, 4, 5, 6, 7, 8]
    assert known(last, 100.1) == [1]
    assert known(last, 150.0, 2, 8) == [1, 2, 8]
    assert known(last, 1e9, 0) == [0]


def test_a_measurement_counts_for_the_errors_that_it_found() -> None:
    last = LastMeasured(100.0, [UNKNOWN] * 9)
    errors = np.full(9, math.nan)
    errors[[1, 4]] = (3.0, -2.0)
    last.measured(Measurement(errors, np.ones(9)), 40.0)
    assert known(last, 140.0) == [1, 4]
    errors[:] = math.nan
    errors[4] = 0.0
    last.measured(Measurement(errors, np.ones(9)), 90.0)
    assert known(last, 140.1) == [4]


def test_times_that_become_known_replace_only_unknown_ones() -> None:
    last = LastMeasured(100.0, [UNKNOWN, 50.0, UNKNOWN, UNKNOWN, *[UNKNOWN] * 5])
    assert known(last, 60.0) == [1]
    last.remembered([10.0, 0.0, UNKNOWN, 55.0, *[UNKNOWN] * 5])
    assert known(last, 110.0) == [0, 1, 3]
    assert known(last, 120.0) == [1, 3]
    last.remembered([119.0] * 9)
    assert known(last, 160.0) == [2, 4, 5, 6, 7, 8]


@pytest.mark.parametrize("predicted", [math.nan, math.inf, -math.inf])
def test_a_prediction_that_is_not_a_number_is_ignored(predicted: float) -> None:
    made = replace(without_models(), predicted=np.full(9, predicted))
    assert LastMeasured(100.0, [UNKNOWN] * 9).outdated(made, 0.0).all()
