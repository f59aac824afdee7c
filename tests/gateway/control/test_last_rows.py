"""The last rows are those of a list that is cut at its beginning, in memory that does not grow."""

import tracemalloc

import numpy as np
import pytest

from gateway.control.last_rows import LastRows

MOST, INPUTS = 7, 3


@pytest.mark.parametrize("count", [0, 1, 6, 7, 8, 20])
@pytest.mark.parametrize("rows", [slice(None), slice(-3, None), slice(2, 5), slice(0, 100), slice(5, 2)])
def test_parts_are_those_of_the_last_rows_of_a_list(count: int, rows: slice) -> None:
    kept, draw = LastRows(INPUTS, MOST), np.random.default_rng(count)
    values, masks = draw.normal(size=(count, INPUTS)), draw.random((count, INPUTS)) < 0.5
    for inputs, valid in zip(values, masks, strict=True):
        kept.append(inputs, valid)
    found, good = kept.part(rows)
    np.testing.assert_array_equal(found, values[-MOST:][rows])
    np.testing.assert_array_equal(good, masks[-MOST:][rows])
    assert len(kept) == min(count, MOST)


@pytest.mark.parametrize("gap", [1, 4, 10**9])
def test_a_gap_is_rows_of_nothing(gap: int) -> None:
    kept = LastRows(INPUTS, MOST)
    kept.append(np.ones(INPUTS), np.ones(INPUTS, dtype=np.bool_))
    kept.append_gap(gap)
    kept.append(np.full(INPUTS, 2.0), np.ones(INPUTS, dtype=np.bool_))
    found, good = kept.part(slice(None))
    expected = [1.0] * (gap < MOST - 1) + [np.nan] * min(gap, MOST - 1) + [2.0]
    np.testing.assert_array_equal(found[:, 0], expected)
    np.testing.assert_array_equal(good[:, 0], np.isfinite(expected))


def test_a_part_stays_as_it_was_when_rows_follow() -> None:
    kept = LastRows(INPUTS, MOST)
    for value in range(2 * MOST):
        kept.append(np.full(INPUTS, float(value)), np.ones(INPUTS, dtype=np.bool_))
        if value == MOST - 1:
            before, good = kept.part(slice(None))
    assert before[:, 0].tolist() == list(range(MOST))
    assert good.all()


def test_a_month_of_rows_takes_what_their_numbers_take() -> None:
    """Month after month: as lists of arrays it was 6.8 MB for 36 inputs."""
    rows, inputs = 8736, 36
    tracemalloc.start()
    try:
        kept = LastRows(inputs, rows)
        for _ in range(2 * rows):
            kept.append(np.zeros(inputs), np.ones(inputs, dtype=np.bool_))
        held, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert held < 1.1 * rows * inputs * 9
