"""Judging on recordings: equal times, estimates before measurements, closed forms for the peers, coverage, savings."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest

from benchmarks.recordings.causal import Peeked, check_asked, check_causal, trial
from benchmarks.recordings.description import InputColumn
from benchmarks.recordings.judge import apply_method, coverage, judge_course, rows_to_measure
from benchmarks.recordings.learner import Learning
from benchmarks.recordings.methods import Given, HoldLast, Method, MethodCourse, Nothing, given_of
from benchmarks.recordings.models import Models, papers, slots
from benchmarks.recordings.peers import Boosting, Process, peers
from benchmarks.recordings.policy import Deciding, Point, savings
from benchmarks.recordings.regressions import Features, Refitted, RidgePath, best_so_far, ridges
from benchmarks.recordings.series import Series
from talc.frame import BoolArray, FloatArray
from talc.settings import TrainingSettings


def series_of(
    truth: FloatArray, inputs: FloatArray, *, off_after: int | None = None, off_steps: int = 0, probing: float = 0.0
) -> Series:
    rows, errors = truth.shape
    k = np.arange(rows)
    run = np.zeros(rows, dtype=np.int64)
    if off_after is not None:
        k[off_after:] += off_steps
        run[off_after:] = 1
    names = tuple(f"t{i}" for i in range(inputs.shape[1]))
    return Series(
        name="made up",
        step_s=300.0,
        k=k,
        run=run,
        input_names=names,
        about=tuple(InputColumn() for _ in names),
        inputs=inputs,
        error_names=tuple(f"e{i}" for i in range(errors)),
        units=("um",) * errors,
        angle=np.zeros(errors, dtype=np.bool_),
        truth=truth,
        noise=np.zeros(errors),
        probing=np.full(errors, probing),
        notes=(),
    )


def ramp(rows: int = 288, errors: int = 2, **more: float) -> Series:
    """In each step error n rises by n plus one, and the input by one."""
    steps = np.arange(rows, dtype=np.float64)[:, None]
    return series_of(steps * (1.0 + np.arange(errors)), steps, **more)  # type: ignore[arg-type]


def wavy(rows: int = 400, errors: int = 3, seed: int = 0, probing: float = 0.5) -> Series:
    """Errors that follow slow random walks of three temperatures."""
    draw = np.random.default_rng(seed)
    t = np.cumsum(draw.normal(0, 0.2, (rows, 3)), axis=0)
    return series_of(t @ draw.normal(0, 4.0, (3, errors)), 20.0 + t, probing=probing)


def test_moments_are_dense_first_then_an_interval_apart_and_at_each_run() -> None:
    series = series_of(np.zeros((60, 1)), np.zeros((60, 1)), off_after=30, off_steps=170)
    used = np.flatnonzero(rows_to_measure(series, 0.5, 60.0))
    assert used.tolist() == [0, 1, 2, 3, 4, 5, 17, 29, 30, 42, 54]
    without = np.flatnonzero(rows_to_measure(series, 0.5, 60.0, measure_first=False))
    assert without.tolist() == [0, 1, 2, 3, 4, 5, 17, 29, 30, 42, 54]  # after 14 h off an interval has passed anyway


def test_hours_off_do_not_shorten_the_beginning() -> None:
    series = series_of(np.zeros((60, 1)), np.zeros((60, 1)), off_after=6, off_steps=200)
    assert rows_to_measure(series, 1.0, 240.0)[:14].tolist() == [True] * 12 + [False] * 2


def test_a_moment_without_a_recorded_error_waits_for_the_next_one() -> None:
    truth = np.zeros((40, 2))
    truth[12:15] = np.nan
    truth[15, 0] = np.nan
    series = series_of(truth, np.zeros((40, 1)))
    assert np.flatnonzero(rows_to_measure(series, 0.0, 60.0)).tolist() == [0, 15, 27, 39]


def test_hold_leaves_a_ramp_by_its_age() -> None:
    """Measured each 12 steps, a ramp of 1 a step leaves 1 to 12 in turn: RMS sqrt(mean(1..12 squared))."""
    series = ramp(errors=1, rows=12 * 20 + 1)
    course = apply_method(HoldLast(), series, rows_to_measure(series, 0.0, 60.0), 0, 0.0, 60.0)
    assert course is not None
    left = series.truth[1:, 0] - course.estimate[1:, 0]
    assert left[:24].tolist() == [*range(1, 13), *range(1, 13)]
    found = judge_course(series, course, 0.0, [0])
    squares = np.tile(np.arange(1.0, 13.0) ** 2, 20)
    assert found.rms == pytest.approx(np.sqrt(squares.sum() / 241))
    assert found.largest == 12.0
    assert np.isnan(found.inside)


def test_nothing_leaves_the_errors_themselves() -> None:
    series = ramp()
    course = apply_method(Nothing(), series, rows_to_measure(series, 0.0, 60.0), 0, 0.0, 60.0)
    assert course is not None
    found = judge_course(series, course, 12.0, [0, 1])
    after = series.truth[144:]
    assert found.rms == pytest.approx(np.sqrt(np.mean(after**2)))
    assert found.p99 == pytest.approx(np.quantile(after, 0.99))
    assert found.by_error == pytest.approx(np.sqrt(np.mean(after**2, axis=0)).tolist())
    assert found.curve[:3] == (1.0, 1.0, 1.0)
    assert np.isnan(found.curve[3])  # nothing was recorded after 24 h


@pytest.mark.parametrize("row", [40, 250])
def test_ridge_is_the_penalised_normal_equations(row: int) -> None:
    """Against a solution with an augmented matrix by least squares, from the same measurements."""
    series = wavy()
    given = given_of(series, rows_to_measure(series, 0.0, 60.0), 0, 0, 12)
    known = np.flatnonzero(given.used[:row])
    deviation = series.inputs - series.inputs[0]
    x = deviation / np.maximum(np.abs(deviation[: known[-1] + 1]).max(axis=0), 3.0)
    y = given.measured[known]
    for number, course in enumerate(Refitted("", RidgePath, "inputs", hindsight=True).courses(given)):
        strength = 10.0 ** (number % 7 - 3)
        centred = x[known] - x[known].mean(axis=0)
        stacked = np.vstack([centred, np.sqrt(strength) * np.eye(3)])
        gains = np.linalg.lstsq(stacked, np.vstack([y - y.mean(axis=0), np.zeros((3, 3))]), rcond=None)[0]
        from_fit = y.mean(axis=0) + (x[row] - x[known].mean(axis=0)) @ gains
        from_last = y[-1] + (x[row] - x[known[-1]]) @ gains
        assert course.estimate[row] == pytest.approx(from_fit if number < 7 else from_last, abs=1e-9)


def test_lagged_features_are_the_step_responses_of_first_order_lags() -> None:
    """An input that jumps by 6 and stays: 6 (1 - exp(-t / tau)), over a span of 6, also across a gap."""
    step = np.where(np.arange(60)[:, None] > 0, 26.0, 20.0)
    series = series_of(np.zeros((60, 1)), step, off_after=30, off_steps=100)
    features = Features.of(given_of(series, np.ones(60, dtype=np.bool_), 0, 0, 1), "lags").at(slice(None), 59)
    for column, tau_s in enumerate((0.0, 900.0, 2700.0, 8100.0, 24300.0)):
        expected = 1.0 - (np.exp(-series.k * 300.0 / tau_s) if tau_s else (series.k == 0))
        assert features[:, column] == pytest.approx(expected)
    anew = replace(series, zero_each_run=True)
    again = Features.of(given_of(anew, np.ones(60, dtype=np.bool_), 0, 0, 1), "lags").at(slice(None), 59)
    assert again[:30] == pytest.approx(features[:30])
    assert again[30:] == pytest.approx(features[30:] - features[30]), "a new reference: the run counts from itself"


def test_the_way_that_was_best_so_far_is_used_next() -> None:
    measured = np.full((6, 2), np.nan)
    measured[[1, 3]] = [[1.0, 5.0], [1.0, 5.0]]
    first, second = np.full((6, 2), 1.0), np.full((6, 2), 5.0)
    first[3, 0], second[3, 0] = 9.0, 1.0
    best = best_so_far(np.stack([first, second]), measured)
    assert best[:, 1].tolist() == [1.0, 1.0, 5.0, 5.0, 5.0, 5.0]
    assert best[:, 0].tolist() == [1.0, 1.0, 1.0, 9.0, 5.0, 5.0]  # 0 and 16 squared, then 64 and 16


def test_the_best_ridge_known_afterwards_leaves_no_more_than_the_one_chosen_by_the_past() -> None:
    given = trial()
    online, hindsight = (method.courses(given) for method in ridges())
    assert len(hindsight) == 14
    truth = given.measured
    left = [np.nanmean((truth - way.estimate) ** 2, axis=0) for way in hindsight]
    assert (np.nanmean((truth - online[0].estimate) ** 2, axis=0) >= np.min(left, axis=0)).all()
    check_causal(ridges()[0], given)


@pytest.mark.parametrize("ridge", ridges(), ids=lambda m: m.name)
def test_ridge_finds_a_ramp_that_is_linear_in_its_input(ridge: Method) -> None:
    series = ramp()
    used = rows_to_measure(series, 0.0, 60.0)
    course, held = (apply_method(method, series, used, 0, 6.0, 60.0) for method in (ridge, HoldLast()))
    assert course is not None
    assert held is not None
    assert judge_course(series, course, 6.0, [0, 1]).rms < 0.1 * judge_course(series, held, 6.0, [0, 1]).rms


def test_boosting_finds_a_step_that_no_line_does() -> None:
    x = np.linspace(-1.0, 1.0, 60)[:, None]
    boosting = Boosting()
    boosting.fit(x, np.where(x > 0.2, 5.0, -5.0))
    (estimate,), _ = boosting.predict(np.array([[-0.5], [0.5]]))
    assert estimate[:, 0] == pytest.approx([-5.0, 5.0], abs=0.5)


def test_the_process_interpolates_and_is_unsure_far_away() -> None:
    """As a closed form of two measurements: without noise it is sure where it was measured, and ignorant far away."""
    x = np.linspace(-1.0, 1.0, 40)[:, None]
    process = Process()
    process.fit(x, np.sin(3.0 * x))
    (estimate,), sigma = process.predict(np.array([[0.33], [50.0]]))
    assert estimate[0, 0] == pytest.approx(np.sin(0.99), abs=0.01)
    assert sigma[0, 0] < 0.02
    assert sigma[1, 0] > 0.5


def test_the_process_measures_when_it_is_unsure() -> None:
    series = wavy(rows=26, errors=1)
    given = given_of(series, np.ones(26, dtype=np.bool_), 0, 12, 1)
    (process, *_) = peers()
    assert isinstance(process, Deciding)
    check_asked(process, given, 2.0)
    course, used = process.decide(given, 2.0)
    assert used[:12].all()
    assert used[12:].tolist() == (1.96 * course.sigma[12:, 0] > 2.0).tolist()
    assert 12 < used.sum() < 26


def test_the_first_hour_is_judged_apart() -> None:
    """A peak within the first hour after the beginning: 12 rows of 300 s."""
    series = ramp(rows=200, errors=2)
    estimate = series.truth.copy()
    estimate[144:156, 1] -= 3.0
    estimate[150, 1] += 8.0
    estimate[156:, 0] += 1.0
    found = judge_course(series, MethodCourse(estimate, np.ones_like(estimate)), 12.0, [0, 1])
    assert found.first_hour.pv == pytest.approx(8.0)
    assert found.first_hour.rms == pytest.approx(np.sqrt((11 * 3.0**2 + 5.0**2) / 24))
    assert (found.later.pv, found.later.rms) == pytest.approx((0.0, np.sqrt(0.5)))


def test_all_methods_are_measured_at_the_same_moments_with_the_same_noise() -> None:
    series = wavy()
    often, seldom = (given_of(series, rows_to_measure(series, 4.0, m), 3, 48, 12) for m in (60.0, 240.0))
    both = often.used & seldom.used
    assert both.sum() > 48
    assert np.array_equal(often.measured[both], seldom.measured[both])
    noise = (often.measured - series.truth)[often.used]
    assert 0.3 < noise.std() < 0.7  # 0.5 was declared
    assert np.isnan(often.measured[~often.used]).all()


@dataclass(frozen=True)
class Peeping:
    """Uses a row's own measurement for its estimate, some rows late or early."""

    early: int
    name: str = "peeping"

    def courses(self, given: Given) -> Sequence[MethodCourse]:
        (held,) = HoldLast().courses(given)
        estimate = held.estimate.copy()
        source = np.arange(len(estimate)) + self.early
        rows = np.flatnonzero(source < len(estimate))
        measured = given.measured[source[rows]]
        estimate[rows] = np.where(np.isfinite(measured), measured, estimate[rows])
        return [MethodCourse(estimate, held.sigma)]


@dataclass(frozen=True)
class Informed:
    """States an uncertainty that is based on the row's own measurement."""

    name: str = "informed"

    def courses(self, given: Given) -> Sequence[MethodCourse]:
        (held,) = HoldLast().courses(given)
        return [MethodCourse(held.estimate, np.abs(given.measured - held.estimate))]


@pytest.mark.parametrize("method", [Peeping(0), Peeping(1), Peeping(5), Informed()])
def test_a_method_that_peeks_is_caught(method: Method) -> None:
    series = wavy()
    given = given_of(series, rows_to_measure(series, 4.0, 60.0), 0, 48, 12)
    with pytest.raises(Peeked, match=method.name):
        check_causal(method, given)


@pytest.mark.slow
@pytest.mark.parametrize("method", [papers(gaps=False)[0], Learning()], ids=lambda m: m.name)
def test_no_method_of_ours_peeks(method: Method) -> None:
    series = wavy()
    given = given_of(series, rows_to_measure(series, 12.0, 60.0), 0, 144, 12)
    check_causal(method, given)


def test_models_through_the_controller_beat_nothing_on_what_they_can_learn() -> None:
    series = wavy(rows=500)
    used = rows_to_measure(series, 12.0, 60.0)
    course = apply_method(Models("", TrainingSettings()), series, used, 0, 12.0, 60.0)
    assert course is not None
    assert not np.isfinite(course.estimate[:100]).any()  # calibrating
    none = np.sqrt(np.mean(series.truth[144:] ** 2))
    found = judge_course(series, course, 12.0, [0, 1, 2])
    assert found.rms < 0.5 * none
    assert np.isfinite(found.inside)


def test_the_learner_estimates_from_the_first_measurements_on() -> None:
    series = wavy(rows=500)
    used = rows_to_measure(series, 0.0, 60.0)
    course = apply_method(Learning(), series, used, 0, 0.0, 60.0)
    held = apply_method(HoldLast(), series, used, 0, 0.0, 60.0)
    assert course is not None
    assert held is not None
    found = judge_course(series, course, 0.0, [0, 1, 2])
    assert found.rms < judge_course(series, held, 0.0, [0, 1, 2]).rms
    assert found.curve[2] < 0.5
    assert 0.8 < found.inside <= 1.0


def test_errors_beyond_nine_are_learnt_as_well_as_the_first_ones() -> None:
    """The same error in every place: the name of a place changes nothing."""
    one = wavy(errors=1, probing=0.0)
    many = series_of(np.repeat(one.truth, 11, axis=1), one.inputs)
    used = rows_to_measure(many, 0.0, 60.0)
    course = apply_method(Learning(), many, used, 0, 0.0, 60.0)
    assert course is not None
    assert np.ptp(course.estimate[1:], axis=1).max() < 1e-9


@pytest.mark.slow
def test_the_learner_rests_on_the_measurements_that_it_asked_for_alone() -> None:
    series = wavy()
    given = given_of(series, np.ones(len(series.k), dtype=np.bool_), 0, 24, 1)
    check_asked(Learning(), given, 5.0)
    often, seldom = (Learning().decide(given, limit)[1] for limit in (2.0, 20.0))
    assert often[:24].all()
    assert often.sum() > seldom.sum()


@pytest.mark.parametrize("measure_first", [True, False])
def test_the_learner_and_a_fixed_interval_begin_a_run_alike(measure_first: bool) -> None:
    series = wavy()
    k = series.k.copy()
    k[len(k) // 2 :] += 144
    series = replace(series, k=k, run=(np.arange(len(k)) >= len(k) // 2).astype(np.int64))
    given = given_of(series, np.ones(len(k), dtype=np.bool_), 0, 12, 1, measure_first)
    begins = np.flatnonzero(np.diff(series.run)) + 1
    _, asked = Learning().decide(given, 20.0)
    assert asked[begins].all() == measure_first
    assert asked[begins + 1].all() == (not measure_first), "the controller asks only once after a pause"
    assert rows_to_measure(series, 1.0, 1e6, measure_first)[begins].all() == measure_first


def test_a_policy_that_looks_at_other_measurements_is_caught() -> None:
    class Peeping(Learning):
        def decide(self, given: Given, limit: float) -> tuple[MethodCourse, BoolArray]:
            course, used = super().decide(given, limit)
            return MethodCourse(course.estimate + 0.1 * given.measured, course.sigma), used

    series = wavy()
    given = given_of(series, np.ones(len(series.k), dtype=np.bool_), 0, 24, 1)
    with pytest.raises(Peeked, match="did not ask for"):
        check_asked(Peeping(), given, 5.0)


def test_any_number_of_errors_finds_places_of_its_unit() -> None:
    groups = slots(np.array([False] * 8 + [True] * 2))
    assert [sorted(group.values()) for group in groups] == [[0, 1, 2, 3, 4, 5, 8, 9], [6, 7]]
    assert all(error < 8 for group in groups for place, error in group.items() if place < 6)
    assert [sorted(g.values()) for g in slots(np.array([True] * 4))] == [[0, 1, 2], [3]]


def test_a_swarm_has_no_course_without_a_dense_beginning() -> None:
    series = wavy()
    used = rows_to_measure(series, 0.0, 60.0)
    assert apply_method(papers(gaps=False)[1], series, used, 0, 0.0, 60.0) is None


def test_replaced_measurements_change_nothing_before_them() -> None:
    """The check itself: it alters the chosen row and all after it."""
    series = ramp()
    given = given_of(series, rows_to_measure(series, 0.0, 60.0), 0, 0, 12)
    check_causal(HoldLast(), replace(given, sigma=np.ones(2)))


def test_coverage_counts_the_recordings_own_noise() -> None:
    draw = np.random.default_rng(5)
    left = draw.normal(0, np.hypot(2.0, 1.5), (40_000, 1))
    sigma = np.full(left.shape, 2.0)
    assert coverage(left, sigma, np.array([1.5])) == pytest.approx(0.95, abs=0.005)
    assert coverage(left, sigma, np.array([0.0])) < 0.9
    sigma[::2] = np.nan
    left[1::2] = 100.0
    assert coverage(left, sigma, np.array([1.5])) == 0.0


def test_only_rows_after_the_beginning_are_judged() -> None:
    series = ramp(rows=200, errors=1)
    estimate = series.truth.copy()
    estimate[:144] += 50.0
    course = MethodCourse(estimate, np.ones_like(estimate))
    assert judge_course(series, course, 12.0, [0]).rms == 0.0
    assert judge_course(series, course, 12.0, [0]).inside == 1.0
    assert judge_course(series, course, 0.0, [0]).largest == 50.0


def test_savings_are_read_off_between_the_fixed_intervals() -> None:
    """Errors that fall with 1 / measurements: half the error needs twice the measurements."""
    fixed = [Point(f"{n}", n, 100.0 / n, 300.0 / n, 0.95) for n in (10, 20, 40, 80)]
    policy = [Point("5 µm", 15, 100.0 / 30, 300.0 / 15, 0.95), Point("1 µm", 15, 0.1, 0.1, 0.95)]
    first, beyond = savings(policy, fixed)
    assert first.at_equal_rms == pytest.approx(0.5)
    assert first.at_equal_p99 == pytest.approx(1.0)
    assert np.isnan(beyond.at_equal_rms)


def test_what_a_denser_interval_left_by_chance_does_not_help_the_policy() -> None:
    fixed = [Point("", n, left, left, 0.95) for n, left in ((10, 8.0), (20, 4.0), (40, 5.0), (80, 2.0))]
    (found,) = savings([Point("", 20, 4.0, 4.0, 0.95)], fixed)
    assert found.at_equal_rms == pytest.approx(1.0)
