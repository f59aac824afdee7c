"""Requested measurements beside fixed intervals, on simulated machines."""

import numpy as np

from benchmarks.policy import few, series_of
from benchmarks.recordings.learner import Learning
from benchmarks.recordings.policy import Sweep
from studies import Days


def test_a_machine_that_little_is_seen_of_is_off_at_night() -> None:
    series = few("axes", 0, hours=30)
    assert series.inputs.shape == (14 * 12 + 6 * 12, 6)
    assert np.flatnonzero(np.diff(series.k) > 1).tolist() == [14 * 12 - 1]
    assert np.diff(series.k).max() == 10 * 12 + 1
    assert series.run.tolist() == [0] * 14 * 12 + [1] * 6 * 12
    assert not any("speed" in name for name in series.input_names)


def test_rows_in_which_the_machine_is_off_are_left_out() -> None:
    rows = np.arange(8.0)
    days = Days(("a", "b"), np.column_stack([rows, -rows]), np.tile(rows[:, None], 9), np.zeros((8, 9)), np.ones(9))
    series = series_of(days, rows % 4 < 2, [1])
    assert series.k.tolist() == [0, 1, 4, 5]
    assert series.run.tolist() == [0, 0, 1, 1]
    assert series.inputs[:, 0].tolist() == [0.0, -1.0, -4.0, -5.0]
    assert series.truth[:, 0].tolist() == [0.0, 1.0, 4.0, 5.0]
    assert series.truth.shape == (4, 6)


def test_a_stricter_limit_measures_more_often_and_leaves_less() -> None:
    series = few("axes", 0, hours=14)
    strict, loose = (Sweep(0.0, limit=limit).points(Learning(), series, 0, True)[0] for limit in (2.5, 14.0))
    assert strict.measurements > 2 * loose.measurements
    assert strict.rms < loose.rms
