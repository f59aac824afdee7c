"""Whatever the requested offsets are, the slew stays within its bounds and its rate."""

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from gateway.model.compensation import Source
from gateway.nc.slew import Slew


def slew(**changes: object) -> Slew:
    settings: dict[str, object] = {
        "bound_um": [50.0, 50.0, 20.0],
        "slew_um_per_s": 1.0,
        "when_stale": "zero",
        "period_s": 1.0,
        "in_force_um": (0.0, 0.0, 0.0),
        "now_s": 0.0,
    }
    return Slew(**(settings | changes))  # type: ignore[arg-type]


def test_reaches_the_target_at_the_stated_rate() -> None:
    s = slew()
    offsets = [s.follow(float(t), np.array([3.5, -2.0, 0.5])).offsets_um for t in range(1, 6)]
    assert offsets == [(1.0, -1.0, 0.5), (2.0, -2.0, 0.5), (3.0, -2.0, 0.5), (3.5, -2.0, 0.5), (3.5, -2.0, 0.5)]


def test_starts_from_what_the_control_has_in_force() -> None:
    step = slew(in_force_um=(12.0, 0.0, -4.0)).follow(1.0, np.zeros(3))
    assert step.offsets_um == (11.0, 0.0, -3.0)


def test_a_hung_gateway_does_not_catch_up_in_one_step() -> None:
    assert slew().follow(600.0, np.array([40.0, 0.0, 0.0])).offsets_um == (1.0, 0.0, 0.0)


def test_the_bound_cuts_and_says_so() -> None:
    step = slew(period_s=1000.0).follow(1000.0, np.array([0.0, 80.0, -30.0]))
    assert step.target_um == (0.0, 50.0, -20.0)
    assert step.offsets_um == (0.0, 50.0, -20.0)
    assert step.bounded == (False, True, True)


@pytest.mark.parametrize("wanted", [None, np.array([math.nan, 1.0, 1.0]), np.array([1.0, math.inf, 1.0])])
def test_without_a_prediction_it_ramps_to_zero_or_holds_as_declared(wanted: np.ndarray | None) -> None:
    to_zero = slew(in_force_um=(2.0, -2.0, 0.0)).follow(1.0, wanted)
    assert (to_zero.offsets_um, to_zero.source) == ((1.0, -1.0, 0.0), Source.NO_MODEL)
    held = slew(in_force_um=(2.0, -2.0, 0.0), when_stale="hold").follow(1.0, wanted, Source.STALE)
    assert (held.offsets_um, held.source) == ((2.0, -2.0, 0.0), Source.STALE)


def test_frozen_time_is_not_saved_up() -> None:
    s = slew()
    s.follow(1.0, np.array([10.0, 0.0, 0.0]))
    assert s.freeze(2.0).offsets_um == (1.0, 0.0, 0.0)
    assert s.follow(3.0, np.array([10.0, 0.0, 0.0])).offsets_um == (2.0, 0.0, 0.0)


any_number = st.floats(allow_nan=True, allow_infinity=True, width=32)


@pytest.mark.slow
@given(
    start=st.tuples(*[st.floats(-20, 20)] * 3),
    period_s=st.sampled_from([1.0, 100.0]),
    asks=st.lists(st.tuples(st.floats(0, 200), st.tuples(any_number, any_number, any_number)), max_size=30),
)
@example(start=(0.0, 0.0, 20.0), period_s=1.0, asks=[(1.0, (0.0, 0.0, 30.0))])
@example(start=(0.0, 0.0, 0.0), period_s=100.0, asks=[(100.0, (80.0, -80.0, 80.0))])
@example(start=(0.0, 0.0, 0.0), period_s=1.0, asks=[(100.0, (80.0, -80.0, 80.0))])
@example(start=(0.0, 0.0, -12.30251473729734), period_s=100.0, asks=[(33.0, (0.0, 0.0, 20.0))])  # the sum rounds up
def test_no_sequence_of_targets_breaks_bound_or_rate(
    start: tuple[float, float, float], period_s: float, asks: list[tuple[float, tuple[float, float, float]]]
) -> None:
    s = slew(in_force_um=start, period_s=period_s)
    now, before = 0.0, np.array(start)
    for wait, wanted in asks:
        now += wait
        after = np.array(s.follow(now, np.array(wanted)).offsets_um)
        assert np.all(np.isfinite(after))
        assert np.all(np.abs(after) <= [50.0, 50.0, 20.0])
        assert np.all(np.abs(after - before) <= min(wait, period_s) + 1e-9)
        before = after


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("bound_um", [1.0, 0.0, 1.0]), ("bound_um", [1.0, -1.0, 1.0]), ("bound_um", [1.0, 1.0]),
        ("bound_um", [1.0] * 4), ("bound_um", [[1.0]] * 3),
        ("bound_um", [1.0, math.nan, 1.0]), ("bound_um", [1.0, math.inf, 1.0]),
        ("slew_um_per_s", 0.0), ("slew_um_per_s", -1.0), ("slew_um_per_s", math.nan),
        ("in_force_um", (math.nan, 0.0, 0.0)), ("in_force_um", (0.0, -math.inf, 0.0)), ("in_force_um", (0.0, 0.0)),
        ("in_force_um", np.zeros((2, 3))), ("in_force_um", np.zeros((4, 1))),
    ],
)  # fmt: skip
def test_refuses_settings_that_cannot_be_safe(field: str, value: object) -> None:
    with pytest.raises(ValueError, match=field):
        slew(**{field: value})


def test_a_shift_that_follows_the_position_keeps_to_bound_and_rate_at_every_position() -> None:
    draw = np.random.default_rng(5)
    s = slew(in_force_um=draw.normal(0.0, 3.0, (3, 4)))
    corners = np.column_stack([np.ones(8), np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T])
    before = None
    for now in range(1, 300):
        wanted = draw.normal(0.0, 30.0, (3, 4)) if now % 50 < 25 else None
        step = s.follow(float(now), wanted, basis=corners[now % 8])
        after = np.array(step.coefficients_um) @ corners.T
        assert step.offsets_um == pytest.approx(tuple(after[:, now % 8]))
        assert np.all(np.array([50.0, 50.0, 20.0]) + 1e-9 >= np.abs(after).T)
        if before is not None:
            assert np.abs(after - before).max() <= 1.0 + 1e-9
        before = after


def test_a_row_beyond_the_bound_keeps_its_shape() -> None:
    wanted = np.array([[40.0, 40.0, 0.0, 20.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0]])
    step = slew(period_s=1000.0, in_force_um=np.zeros((3, 4))).follow(1000.0, wanted)
    assert step.bounded == (True, False, False)
    np.testing.assert_allclose(step.coefficients_um, wanted * np.array([[0.5], [1.0], [0.0]]))


def test_the_smallest_settings_that_are_safe() -> None:
    step = slew(bound_um=[1e-3, 0.5, 1.0], slew_um_per_s=1e-3).follow(1.0, np.array([9.0, 0.0, 0.0]))
    assert step.offsets_um == (1e-3, 0.0, 0.0)


def test_time_that_goes_back_moves_nothing_and_is_not_caught_up() -> None:
    s = slew(in_force_um=(3.0, 0.0, 0.0), now_s=10.0)
    assert s.follow(5.0, np.zeros(3)).offsets_um == (3.0, 0.0, 0.0)
    assert s.follow(5.5, np.zeros(3)).offsets_um == (2.5, 0.0, 0.0)


def test_the_first_step_counts_from_the_report_of_what_is_in_force() -> None:
    assert slew(in_force_um=(3.0, 0.0, 0.0), now_s=10.0).follow(10.25, np.zeros(3)).offsets_um == (2.75, 0.0, 0.0)


def test_the_largest_offset_is_that_of_any_axis_at_any_position() -> None:
    assert slew(in_force_um=(1.0, -4.0, 2.0)).largest_um == 4.0
    assert slew(in_force_um=np.array([[1.0, 2.0], [-3.0, 3.0], [0.5, -4.0]])).largest_um == 6.0
    s = slew(in_force_um=(0.0, -2.5, 1.0))
    found = []
    for now in (1.0, 2.0, 3.0):
        s.follow(now, None)
        found.append(s.largest_um)
    assert found == [1.5, 0.5, 0.0]


@pytest.mark.parametrize("source", [Source.FROZEN, Source.NOT_READY, Source.UNANSWERED])
def test_a_frozen_step_has_its_reason_and_is_bounded_by_nothing(source: Source) -> None:
    step = slew(in_force_um=np.array([[90.0, 1.0], [2.0, 3.0], [0.0, 0.0]])).freeze(1.0, np.array([1.0, 0.5]), source)
    assert step.target_um == step.offsets_um == (90.5, 3.5, 0.0)
    assert (step.source, step.bounded) == (source, (False, False, False))
    assert step.coefficients_um == ((90.0, 1.0), (2.0, 3.0), (0.0, 0.0))
    assert slew().freeze(1.0).source is Source.FROZEN


def test_exactly_at_its_bound_nothing_is_cut() -> None:
    step = slew(period_s=1000.0).follow(1000.0, np.array([50.0, -50.0, 20.0]))
    assert step.offsets_um == (50.0, -50.0, 20.0)
    assert step.bounded == (False, False, False)


def test_a_prediction_and_any_other_reason_keep_their_name() -> None:
    s = slew()
    assert s.follow(1.0, np.ones(3)).source is Source.PREDICTION
    assert s.follow(2.0, np.ones(3), Source.PAUSED).source is Source.PAUSED
    assert s.follow(3.0, None, Source.STOPPED).source is Source.STOPPED
    assert s.follow(4.0, None, Source.PAUSED).source is Source.PAUSED


def test_without_a_basis_it_is_the_shift_at_the_reference() -> None:
    start = np.array([[1.0, 5.0], [2.0, -5.0], [3.0, 0.5]])
    assert slew(in_force_um=start).freeze(1.0).offsets_um == (1.0, 2.0, 3.0)
    each = np.array([[1.0, 1.0], [0.0, 1.0], [1.0, 0.0]])
    assert slew(in_force_um=start).freeze(1.0, each).offsets_um == (6.0, -5.0, 3.0)


def test_rows_of_one_cause_move_in_proportion_to_a_target_that_only_the_control_bounds() -> None:
    s = slew(in_force_um=np.zeros((3, 2)), together=True, period_s=10.0)
    wanted = np.array([[60.0, 20.0], [-30.0, 10.0], [8.0, 0.0]])
    step = s.follow(8.0, wanted, basis=np.array([1.0, 1.0]))
    np.testing.assert_allclose(step.coefficients_um, wanted * 0.1)
    assert step.target_um == (50.0, -20.0, 8.0)
    assert step.offsets_um == pytest.approx((8.0, -2.0, 0.8))
    assert step.bounded == (True, False, False)
    for now in range(18, 118, 10):
        step = s.follow(float(now), wanted, basis=np.array([1.0, -1.0]))
    np.testing.assert_array_equal(step.coefficients_um, wanted)
    assert step.offsets_um == (40.0, -40.0, 8.0)
    assert step.bounded == (False, False, False)
    s.follow(110.0, None)
    assert s.largest_um == pytest.approx(78.0)


def test_two_columns_beyond_the_bound_are_scaled_and_not_cut_one_by_one() -> None:
    wanted = np.array([[40.0, 60.0], [0.0, 0.0], [0.0, 0.0]])
    step = slew(period_s=1000.0, in_force_um=np.zeros((3, 2))).follow(1000.0, wanted)
    np.testing.assert_allclose(step.coefficients_um, wanted * 0.5)
