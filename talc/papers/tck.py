"""The earlier sequential selector (Z22 §2): cluster the sensors, take the most similar one, model, go on with the rest.

Similarity is the Time Series Cluster Kernel (Mikalsen, Bianchi, Soguero-Ruiz, Jenssen, Pattern Recognition 76 (2018)
569-581): an ensemble of diagonal Gaussian mixtures with informative priors, fitted by MAP-EM to random segments and
random subsets of the series; two series are similar if the mixtures assign them alike. Missing values do not count.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from talc.frame import FloatArray
from talc.papers.arx import Regression, least_squares_fit, simulate
from talc.papers.criteria import bic
from talc.papers.window import Structure

_INITIALISATIONS: Final = 30
_SMALL_ENSEMBLE: Final = 10
"""Largest number of mixture components for fewer than 100 series."""
_LARGE_ENSEMBLE: Final = 40
_EM_STEPS: Final = 20
_FLOOR: Final = -4.5
"""Logarithm of the normal density at three standard deviations, less a constant: no single value decides."""
_ALIKE: Final = 0.7
"""Sensors whose |correlation| with each other averages above this form one cluster (choice)."""
MOST_INPUTS: Final = 8


@dataclass(frozen=True, slots=True, eq=False)
class _SegmentMixture:
    """A diagonal Gaussian mixture over one segment of the steps."""

    begin: int
    share: FloatArray
    """(components,)"""
    mean: FloatArray
    """(components, length)"""
    std: FloatArray
    """(components,)"""
    assigned: FloatArray
    """(N, components) posteriors of the series that the ensemble was fitted to."""

    def posterior(self, series: FloatArray) -> FloatArray:
        """(n, components) of series (n, T), whether it was fitted to them or not."""
        values = series[:, self.begin : self.begin + self.mean.shape[1]]
        known = np.isfinite(values)
        return _posterior(np.where(known, values, 0.0), known.astype(np.float64), self.share, self.mean, self.std)


class Ensemble:
    """Mixtures fitted to N series (N, T), z-scored; NaN: missing.

    ValueError: fewer than two series or fewer than seven steps.
    """

    def __init__(self, series: FloatArray, *, seed: int, initialisations: int = _INITIALISATIONS) -> None:
        n, steps = series.shape
        if n < 2 or steps < 7:
            raise ValueError(f"series has shape {series.shape}: expected at least (2, 7)")
        draw = np.random.default_rng(seed)
        largest = _SMALL_ENSEMBLE if n < 100 else _LARGE_ENSEMBLE
        self._mixtures = [
            _mixture(series, components, draw) for _ in range(initialisations) for components in range(2, largest + 1)
        ]
        self._length: FloatArray = np.sqrt(sum((m.assigned**2).sum(axis=1) for m in self._mixtures))

    def kernel(self) -> FloatArray:
        """(N, N), normalised so that a series has 1 with itself."""
        total = sum(m.assigned @ m.assigned.T for m in self._mixtures)
        return np.asarray(total / np.outer(self._length, self._length), dtype=np.float64)

    def likeness(self, series: FloatArray) -> FloatArray:
        """(N,) of one further series (T,) to each of them: 1 for one of them itself.

        The mixtures stay as they are (section 3.3 of the paper, test data).
        """
        own = [(m, m.posterior(series[None])[0]) for m in self._mixtures]
        length = np.sqrt(sum(float(p @ p) for _, p in own))
        return np.asarray(sum(m.assigned @ p for m, p in own) / (self._length * length), dtype=np.float64)


def _mixture(series: FloatArray, components: int, draw: "np.random.Generator") -> _SegmentMixture:
    """Fitted to a part of the series on one segment."""
    n, steps = series.shape
    a0, b0, n0 = draw.uniform(0.001, 1.0), draw.uniform(0.005, 0.2), draw.uniform(0.001, 0.2)
    longest = min(int(0.8 * steps), 25)
    length = int(draw.integers(6, max(longest, 6) + 1))
    begin = int(draw.integers(0, steps - length + 1))
    everyone = series[:, begin : begin + length]
    known = np.isfinite(everyone)
    values = np.where(known, everyone, 0.0)
    some = draw.permutation(n)[: max(2, round(0.9 * n))]
    x, r = values[some], known[some].astype(np.float64)

    counts = np.maximum(r.sum(axis=0), 1.0)
    prior_mean = (r * x).sum(axis=0) / counts
    spread = float(np.sqrt((r * (x - prior_mean) ** 2).sum() / max(r.sum(), 1.0))) or 1.0
    time = np.arange(length)
    prior = spread * b0 * np.exp(-a0 * (time[:, None] - time[None, :]) ** 2) + 1e-6 * np.eye(length)
    precision = np.linalg.inv(prior)
    assigned = np.eye(components)[draw.integers(0, components, some.size)]
    mean = np.tile(prior_mean, (components, 1))
    for _ in range(_EM_STEPS):
        share = assigned.mean(axis=0)
        weight = assigned.T @ r
        first, second = assigned.T @ (r * x), assigned.T @ (r * x**2)
        square = (second - 2.0 * mean * first + weight * mean**2).sum(axis=1)
        variance = (n0 * spread**2 + np.maximum(square, 0.0)) / (n0 + weight.sum(axis=1))
        system = np.repeat(precision[None], components, axis=0)
        system[:, time, time] += weight / variance[:, None]
        mean = np.linalg.solve(system, (precision @ prior_mean + first / variance[:, None])[:, :, None])[:, :, 0]
        std = np.sqrt(variance)
        assigned = _posterior(x, r, share, mean, std)
    return _SegmentMixture(begin, share, mean, std, _posterior(values, known.astype(np.float64), share, mean, std))


def _posterior(x: FloatArray, r: FloatArray, share: FloatArray, mean: FloatArray, std: FloatArray) -> FloatArray:
    z = (x[:, None, :] - mean[None]) / std[None, :, None]
    z *= z
    z *= -0.5
    np.maximum(z, _FLOOR, out=z)
    logs = (z @ r[:, :, None])[:, :, 0] - r.sum(axis=1)[:, None] * np.log(std) + np.log(np.maximum(share, 1e-300))
    logs -= logs.max(axis=1, keepdims=True)
    weights = np.exp(logs)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True), dtype=np.float64)


def offered(u: FloatArray) -> FloatArray:
    """(2 n, T) of inputs (T, n): as they are and mirrored, because anticorrelated ones count as dissimilar."""
    return np.vstack([u.T, -u.T])


def select_by_clusters(regression: Regression, sensors: Ensemble, *, most: int = MOST_INPUTS) -> Structure:
    """Inputs one by one, at the regression's largest orders, while the BIC of the free run falls.

    The first input is the one most similar to the output itself, each further one the most similar to the residual of
    the model's free run: one-step residuals of a model with memory are nearly white and similar to nothing.
    sensors: fitted to the offered inputs of the regression's window, `offered`; most: largest number of inputs.
    Clusters are those of average linkage on 1 - |correlation|.
    """
    window, order = regression.window, regression.nb
    open_inputs = [s for s in range(window.u.shape[1]) if window.u[:, s].std() > 1e-9]
    cluster = _clusters(window.u, open_inputs)
    chosen: list[int] = []
    best = Structure(regression.na, (), ())
    left = regression.y - regression.y.mean()
    cost = bic(left, 1)
    while open_inputs and len(chosen) < most:
        # What remains to be explained, where it is known.
        target = np.full(len(window.y), np.nan)
        target[regression.steps] = left
        target = (target - np.nanmean(target)) / max(float(np.nanstd(target)), 1e-12)
        likeness = sensors.likeness(target).reshape(2, -1).max(axis=0)
        nearest = max(open_inputs, key=lambda i: float(likeness[i]))
        candidate = tuple(sorted([*chosen, nearest]))
        structure = Structure(regression.na, candidate, (order,) * len(candidate))
        parameters = least_squares_fit(regression, structure).parameters
        fresh = regression.y - simulate(window, structure, parameters)[regression.steps]
        fresh_cost = bic(fresh, 1 + structure.na + len(candidate) * (order + 1))
        if fresh_cost >= cost:
            break
        best, left, cost = structure, fresh, fresh_cost
        chosen.append(nearest)
        gone = cluster[nearest]
        open_inputs = [s for s in open_inputs if cluster[s] != gone]
    return best


def _clusters(u: FloatArray, inputs: list[int]) -> dict[int, int]:
    """Cluster of each input."""
    from scipy.cluster.hierarchy import fcluster, linkage  # see talc.papers.arx
    from scipy.spatial.distance import squareform

    if len(inputs) < 2:
        return dict.fromkeys(inputs, 1)
    distance = np.clip(1.0 - np.abs(np.corrcoef(u[:, inputs].T)), 0.0, None)
    np.fill_diagonal(distance, 0.0)
    tree = linkage(squareform(distance, checks=False), method="average")
    labels = fcluster(tree, 1.0 - _ALIKE, criterion="distance")
    return dict(zip(inputs, (int(label) for label in labels), strict=True))
