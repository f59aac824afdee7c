"""ARX by least squares, guarded and refined, against NumPy, closed forms and the pitfalls of noisy thermal data."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from talc.papers.arx import Regression, followed, guarded_fit, least_squares_fit, refine, simulate
from talc.papers.output_error import Design, fit
from talc.papers.window import Coefficients, Structure, Window

Array = NDArray[np.float64]


def window(u: Array, y: Array, y_std: float = 1.0) -> Window:
    return Window(u, y, y.copy(), y_std)


def lagging(seed: int, noise: float, steps: int = 500) -> tuple[Window, Array]:
    """y = 0.95 y + 0.05 (1.5 u1 - 0.8 u2) in free run, inputs slow themselves; measured with white noise."""
    draw = np.random.default_rng(seed)
    heat = np.repeat(draw.normal(size=(steps // 10 + 1, 2)), 10, axis=0)[:steps]
    u = lfilter([0.1], [1.0, -0.9], heat, axis=0)
    truth = lfilter([0.05], [1.0, -0.95], u @ np.array([1.5, -0.8]))
    return window(u, truth + noise * draw.normal(size=steps)), truth


BOTH = Structure(1, (0, 1), (0, 0))


def test_coefficients_and_intervals_are_those_of_textbook_least_squares() -> None:
    from scipy.stats import t as student  # a second that only this test needs to spend

    w, _ = lagging(1, 0.02)
    found = least_squares_fit(Regression(w, 2, 1), Structure(2, (0, 1), (1, 0)))
    k = np.arange(2, 500)
    x = np.column_stack([np.ones(498), w.y[k - 1], w.y[k - 2], w.u[k, 0], w.u[k - 1, 0], w.u[k, 1]])
    theta, rest, *_ = np.linalg.lstsq(x, w.y[k], rcond=None)
    std = np.sqrt(np.diag(np.linalg.inv(x.T @ x)) * rest[0] / (498 - 6))
    p = found.parameters
    np.testing.assert_allclose(np.concatenate([[p.intercept], -p.a, *p.b]), theta, rtol=1e-8)
    np.testing.assert_allclose(found.std, std, rtol=1e-8)
    reach = student.ppf(0.975, 492) * std[1]
    np.testing.assert_allclose(found.interval()[1], [-theta[1] - reach, -theta[1] + reach], rtol=1e-7)


def test_95_percent_intervals_hold_the_truth_in_95_percent_of_cases() -> None:
    hits = 0
    for seed in range(300):
        draw = np.random.default_rng(seed)
        u = draw.normal(size=(120, 1))
        y = lfilter([0.5], [1.0, -0.6], u[:, 0]) + lfilter([1.0], [1.0, -0.6], draw.normal(0, 0.3, 120))
        low, high = least_squares_fit(Regression(window(u, y), 1, 0), Structure(1, (0,), (0,))).interval()[2]
        hits += bool(low <= 0.5 <= high)
    assert 0.91 <= hits / 300 <= 0.985  # three standard deviations of a binomial


def test_fir_and_static_models_are_the_cases_without_past_outputs() -> None:
    draw = np.random.default_rng(2)
    u = draw.normal(size=(200, 2))
    y = 1.0 + 2.0 * u[:, 0] - np.concatenate([[0.0], u[:-1, 1]])
    found = least_squares_fit(Regression(window(u, y), 0, 1), Structure(0, (0, 1), (0, 1)))
    np.testing.assert_allclose(np.concatenate(found.parameters.b), [2.0, 0.0, -1.0], atol=1e-10)
    assert found.parameters.intercept == pytest.approx(1.0)
    assert found.parameters.a.size == 0


def test_a_masked_row_never_matters() -> None:
    w, _ = lagging(3, 0.05)
    y = w.y.copy()
    y[100:140] = np.nan
    plain = least_squares_fit(Regression(window(w.u, y), 1, 0), BOTH)
    wild = w.u.copy()
    wild[101:140] = 1e6  # rows whose output and predecessor are unknown
    other = least_squares_fit(Regression(window(wild, y), 1, 0), BOTH)
    np.testing.assert_array_equal(plain.parameters.b, other.parameters.b)


def test_scaling_units_changes_nothing_but_units() -> None:
    w, _ = lagging(4, 0.05)
    plain = least_squares_fit(Regression(w, 1, 0), BOTH).parameters
    scaled = least_squares_fit(Regression(window(w.u * 1e6, w.y), 1, 0), BOTH).parameters
    np.testing.assert_allclose(np.concatenate(scaled.b) * 1e6, np.concatenate(plain.b), rtol=1e-9)


def test_noise_shrinks_the_one_step_pole_and_the_free_run_keeps_it() -> None:
    one_step, refined, errors = [], [], []
    for seed in range(8):
        w, truth = lagging(seed, 0.1)
        start = least_squares_fit(Regression(w, 1, 0), BOTH).parameters
        better = refine(w, BOTH, start)
        one_step.append(-start.a[0])
        refined.append(-better.a[0])
        errors.append([np.nanstd(simulate(w, BOTH, p) - truth) for p in (start, better)])
    assert np.median(one_step) < 0.93  # half the true time constant
    assert np.median(refined) == pytest.approx(0.95, abs=0.01)
    assert (np.array(errors)[:, 1] < 0.5 * np.array(errors)[:, 0]).all()


def test_refining_uses_rows_whose_past_was_not_measured() -> None:
    w, truth = lagging(9, 0.1, steps=1500)
    y = np.full(1500, np.nan)
    y[::6] = w.y[::6]
    sparse = window(w.u, y)
    assert Regression(sparse, 1, 0).y.size == 0
    refined = refine(sparse, BOTH, Coefficients(np.array([-0.8]), (np.array([0.1]), np.array([-0.1])), 0.0))
    assert -refined.a[0] == pytest.approx(0.95, abs=0.02)
    assert np.nanstd(simulate(sparse, BOTH, refined) - truth) < 0.03


def test_an_unmeasured_output_is_the_models_own_and_a_measurement_moves_its_history() -> None:
    u = np.zeros((6, 1))
    y = np.array([np.nan, 4.0, np.nan, np.nan, 5.0, np.nan])
    p = Coefficients(np.array([-0.5, -0.25]), (np.array([1.0]),), 0.0)  # y = 0.5 y[k-1] + 0.25 y[k-2]
    known = followed(window(u, y), Structure(2, (0,), (0,)), p)
    # From 4, 4: 3 in row 2, then 0.5 · 3 + 0.25 · 4 = 2.5; measured 5 where 2.0 was expected: 5, 5.5 and 3.875.
    np.testing.assert_allclose(known, [np.nan, 4.0, 3.0, 2.5, 5.0, 0.5 * 5.0 + 0.25 * (2.5 + 3.0)])


def test_the_output_error_fit_agrees_with_the_refined_free_run() -> None:
    w, _ = lagging(10, 0.1)
    refined = refine(w, BOTH, least_squares_fit(Regression(w, 1, 0), BOTH).parameters)
    design = Design.make(w.u, (-float(refined.a[0]),), 1, np.ones(500, dtype=np.bool_))
    filtered = fit(design, (1, 1), w.y, 0.0, 6)
    np.testing.assert_allclose(np.concatenate(filtered.b), np.concatenate(refined.b), rtol=0.05)


def test_guards_hold_where_the_free_fit_breaks_them() -> None:
    draw = np.random.default_rng(11)
    u = draw.normal(size=(60, 1))
    y = np.cumsum(np.cumsum(u[:, 0]))  # an integrator: its poles are at 1
    regression = Regression(window(u, y), 2, 1)
    structure = Structure(2, (0,), (1,))
    free = least_squares_fit(regression, structure).parameters
    assert np.abs(np.roots([1.0, *free.a])).max() > 0.999
    guarded = guarded_fit(regression, structure, max_pole=0.95, max_gain=3.0)
    assert np.abs(np.roots([1.0, *guarded.a])).max() <= 0.95 + 1e-6
    assert abs(guarded.b[0].sum() / (1.0 + guarded.a.sum())) <= 3.0 + 1e-3


def test_guards_that_do_not_bind_change_nothing() -> None:
    w, _ = lagging(12, 0.01)
    regression = Regression(w, 1, 1)
    structure = Structure(1, (0, 1), (1, 0))
    free = least_squares_fit(regression, structure).parameters
    guarded = guarded_fit(regression, structure, max_pole=0.999)
    np.testing.assert_allclose(guarded.a, free.a, atol=1e-5)
    np.testing.assert_allclose(np.concatenate(guarded.b), np.concatenate(free.b), atol=1e-4)


def test_a_duplicate_or_constant_input_gets_no_standard_error() -> None:
    w, _ = lagging(13, 0.05)
    u = np.column_stack([w.u, w.u[:, 0], np.zeros(500)])
    found = least_squares_fit(Regression(window(u, w.y), 1, 0), Structure(1, (0, 1, 2, 3), (0, 0, 0, 0)))
    assert np.isnan(found.std).sum() == 2
    assert np.isfinite(np.concatenate(found.parameters.b)).all()


def test_too_few_rows_and_wrong_orders_are_refused() -> None:
    w, _ = lagging(14, 0.05, steps=4)
    with pytest.raises(ValueError, match="3 rows for 4 coefficients"):
        least_squares_fit(Regression(w, 1, 0), BOTH)
    with pytest.raises(ValueError, match="expected na <= 1"):
        least_squares_fit(Regression(w, 1, 0), Structure(2, (0,), (0,)))
    with pytest.raises(ValueError, match="na = -1"):
        Regression(w, -1, 0)


@pytest.mark.parametrize(("c", "expected"), [(0.0, -0.8), (-0.8, -0.588)])
def test_a_published_example_of_least_squares_and_coloured_noise(c: float, expected: float) -> None:
    # Söderström & Stoica, System Identification (1989), example 2.3: y + a y[k-1] = b u[k-1] + e + c e[k-1] with
    # a = -0.8, b = 1, white u and e of variance 1. Least squares tends to a - c (1 - a²) / (b² + 1 + c² - 2 a c).
    draw = np.random.default_rng(0)
    steps = 200_000
    u, e = draw.normal(size=(2, steps))
    y = lfilter([0.0, 1.0], [1.0, -0.8], u) + lfilter([1.0, c], [1.0, -0.8], e)
    found = least_squares_fit(Regression(window(u[:, None], y), 1, 1), Structure(1, (0,), (1,))).parameters
    assert found.a[0] == pytest.approx(expected, abs=0.006)
    assert found.b[0][1] == pytest.approx(1.0, abs=0.01)
