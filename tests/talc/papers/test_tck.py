"""The Time Series Cluster Kernel on series whose clusters are known, and the sequential selection on top of it."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from talc.papers.arx import Regression
from talc.papers.tck import Ensemble, offered, select_by_clusters
from talc.papers.window import Structure, Window
from tests.benches.thermal_series import series

Array = NDArray[np.float64]


def two_kinds(missing: float = 0.0) -> Array:
    """Ten sines and ten cosines of one frequency, noisy."""
    draw = np.random.default_rng(1)
    t = np.arange(60) / 8.0
    rows = np.array([np.sin(t + (i >= 10) * np.pi / 2) for i in range(20)]) + 0.2 * draw.normal(size=(20, 60))
    rows[draw.random(rows.shape) < missing] = np.nan
    return rows


@pytest.mark.slow
@pytest.mark.parametrize("missing", [0.0, 0.3])
def test_series_of_one_kind_are_more_alike_than_of_two(missing: float) -> None:
    kernel = Ensemble(two_kinds(missing), seed=2).kernel()
    own = np.concatenate([kernel[:10, :10][~np.eye(10, dtype=bool)], kernel[10:, 10:][~np.eye(10, dtype=bool)]])
    other = kernel[:10, 10:]
    assert np.median(own) > np.median(other) + 0.1
    nearest = [int(np.argsort(row)[-2]) for row in kernel]  # after the series itself
    assert sum((i < 10) == (j < 10) for i, j in enumerate(nearest)) >= 18


def test_it_is_a_kernel() -> None:
    kernel = Ensemble(two_kinds(), seed=3, initialisations=4).kernel()
    np.testing.assert_allclose(kernel, kernel.T)
    np.testing.assert_allclose(np.diag(kernel), 1.0)
    assert np.linalg.eigvalsh(kernel).min() > -1e-9
    np.testing.assert_array_equal(kernel, Ensemble(two_kinds(), seed=3, initialisations=4).kernel())


def chosen(u: Array, y: Array, na: int = 0, nb: int = 0) -> Structure:
    return select_by_clusters(Regression(Window(u, y, y.copy(), 1.0), na, nb), Ensemble(offered(u), seed=1))


@pytest.mark.slow
def test_a_further_series_is_as_like_as_if_it_were_one_of_them() -> None:
    ensemble = Ensemble(two_kinds(), seed=3)
    np.testing.assert_allclose(ensemble.likeness(two_kinds()[4]), ensemble.kernel()[4], atol=1e-12)
    other = np.sin(np.arange(60) / 8.0) + 0.2 * np.random.default_rng(9).normal(size=60)
    other[::3] = np.nan
    likeness = ensemble.likeness(other)
    assert likeness[:10].min() > likeness[10:].max()


@pytest.mark.slow
def test_an_input_that_makes_the_output_is_chosen_and_its_cluster_dropped() -> None:
    s = series(300, seed=3)
    u = (s.inputs - s.inputs.mean(0)) / s.inputs.std(0)
    twin = np.column_stack([u, u[:, 4] + 0.01 * np.random.default_rng(0).normal(size=300)])
    y = u[:, 4] + 0.1 * np.random.default_rng(1).normal(size=300)
    structure = chosen(twin, y)
    assert len({4, 12} & set(structure.inputs)) == 1


@pytest.mark.slow
def test_a_mirrored_series_is_found() -> None:
    s = series(300, seed=5, sensors=12)
    u = (s.inputs - s.inputs.mean(0)) / s.inputs.std(0)
    y = -u[:, 7] + 0.1 * np.random.default_rng(1).normal(size=300)
    assert chosen(u, y).inputs == (7,)
    alone = Ensemble(u.T, seed=1).likeness(-u[:, 7])
    assert alone[7] < np.median(alone), "as it is it would be among the least similar"


@pytest.mark.slow
@pytest.mark.parametrize("column", [2, 9])
def test_a_model_with_memory_finds_the_input_that_drives_it(column: int) -> None:
    """Without any input its one-step fit leaves nearly white residuals, which resemble no input at all."""
    s = series(300, seed=4, sensors=12)
    u = (s.inputs - s.inputs.mean(0)) / s.inputs.std(0)
    y = lfilter([0.1], [1.0, -0.9], u[:, column]) + 0.02 * np.random.default_rng(1).normal(size=300)
    y = (y - y.mean()) / y.std()
    assert column in chosen(u, y, 1, 1).inputs


def test_too_little_is_refused() -> None:
    with pytest.raises(ValueError, match="expected at least"):
        Ensemble(np.zeros((1, 50)), seed=1)
