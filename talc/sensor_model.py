"""Models of how temperatures predict each other, judged on rows from which they were not learnt.

With P the inverse of their covariance (plus the sensors' own noise), an input's prediction from all others misses it by
e_i = (P x)_i / P_ii, and a pair's from the rest by P_AA^-1 (P x)_A: every leave-one-out and leave-two-out ridge
regression from one inverse. Blocks of rows, as long as the window that is judged later, are left out in turn.

Where loads are known (talc.load_heat), what they explain is taken from x first; by the theorem of Frisch, Waugh and
Lovell the residuals are then those of a regression on the others and on the loads.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from talc.frame import LARGEST_INPUT, LEAST_VALID, BoolArray, FloatArray
from talc.load_heat import LoadHeat, LoadScale, heat_of, scale_of
from talc.settings import SensorCheckSettings
from talc.steps import DAY_S, HOUR_S, steps_in

_CHANGE_S: Final = 0.5 * HOUR_S
"""Rows this far apart are compared; with a longer step, successive ones."""
_NOISE_K2: Final = 0.003
"""Variance of a sensor's noise (0.05 K) and of steps of 0.1 K."""
_LEAST_BLOCKS: Final = 3
_LEAST_OF_BLOCK: Final = 0.5
_BLOCK_WORTH: Final = 0.3
"""Blocks of one day err alike: this many count as independent (for the leverage)."""
_OTHER_DAYS: Final = 1.3
"""Days not learnt differ by more than blocks of the learnt ones do: factor on the offset's threshold."""
_YEAR_S: Final = 365.25 * DAY_S
_MOST_AT_ONCE: Final = 200_000
"""Pairs times rows: 1.6 MB an array."""
_LEAST_GAINED: Final = 0.9
"""Loads are taken in if with them left-out residuals have at most this share of their mean squares (geometric mean)."""
_PRIOR_BLOCKS: Final = 4.0
"""Weight of all inputs' median variance in each one's own."""


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """One view (levels or changes) of m inputs."""

    mean: FloatArray
    """(m,) K"""
    covariance: FloatArray
    """(m, m) K²"""
    pairs: FloatArray
    """(3, m, m) of residuals without i and j: variance of i's, of j's, and their covariance; K²."""
    heat: LoadHeat
    """What loads explain; mean and covariance are of the rest."""

    def part(self, keep: Sequence[int]) -> "View":
        """The same for some of the inputs."""
        pairs = self.pairs[:, keep][:, :, keep]
        return View(self.mean[keep], self.covariance[np.ix_(keep, keep)], pairs, self.heat.part(keep))

    def off(self, x: FloatArray, features: FloatArray) -> FloatArray:
        """(T, m) what neither the mean nor the loads explain of rows (T, m) with features (T, F)."""
        return np.asarray(x - self.mean - self.heat.explained(features))


@dataclass(frozen=True, slots=True, eq=False)
class SensorModel:
    """What was learnt about m inputs."""

    names: tuple[str, ...]
    blocks: int
    offset_std: FloatArray
    """(m,) standard deviation of a window's mean residual, K, while the other inputs are as learnt."""
    offset_threshold: float
    """In standard deviations; for all inputs together the stated number of false alarms a year."""
    swap_threshold: float
    """Log-likelihood ratio; for all pairs together likewise."""
    quietest_K: float  # noqa: N815
    """Root mean square of half-hourly changes in the quietest window that was learnt."""
    level: View
    change: View
    step_s: float
    """Grid step of the rows, of those that are judged too."""
    loads: LoadScale | None = None
    """Loads that predict the inputs; None: none does."""
    without_loads: "SensorModel | None" = None
    """How the inputs predict each other when the loads are unknown."""

    @property
    def change_steps(self) -> int:
        """How many rows apart those are that are compared."""
        return steps_in(_CHANGE_S, self.step_s)

    @property
    def freedom(self) -> float:
        """Degrees of freedom of the variances."""
        return _PRIOR_BLOCKS + self.blocks

    @property
    def worth(self) -> float:
        """Number of independent windows that were learnt from, by which a leverage is divided."""
        return _BLOCK_WORTH * self.blocks

    def part(self, names: Sequence[str]) -> "SensorModel":
        """The same for some of the inputs."""
        keep = [self.names.index(name) for name in names]
        return replace(
            self,
            names=tuple(names),
            offset_std=self.offset_std[keep],
            level=self.level.part(keep),
            change=self.change.part(keep),
        )


def learn(
    names: Sequence[str],
    inputs: FloatArray,
    valid: BoolArray,
    settings: SensorCheckSettings,
    loads: Sequence[str] = (),
    step_s: float = 300.0,
) -> SensorModel | None:
    """How these inputs predict each other. None: fewer than 3 windows of good rows, or than 3 inputs.

    inputs: (T, m + L) consecutive grid steps of step_s, degC, the loads in their own units; valid: (T, m + L); loads:
    the L names that are loads. Inputs with less than 80 % good rows are left out. Loads are taken in if with them the
    inputs are predicted better in blocks that were left out. ValueError: shapes that do not fit together.
    """
    inputs, valid = masked(names, inputs, valid)
    inputs, valid = inputs[-settings.learn_steps :], valid[-settings.learn_steps :]
    share = valid.sum(axis=0) / max(len(valid), 1)
    keep = [i for i in range(len(names)) if names[i] not in loads and share[i] >= LEAST_VALID]
    x, good = inputs[:, keep], np.asarray(valid[:, keep].all(axis=1), dtype=np.bool_)
    told = tuple(names[i] for i in keep)
    alone, _ = _learnt(told, x, np.empty((len(x), 0)), good, settings, step_s)
    driving = [i for i in range(len(names)) if names[i] in loads]
    scale = scale_of([names[i] for i in driving], inputs[:, driving], valid[:, driving], step_s)
    if alone is None or scale is None:
        return alone
    own = [names.index(name) for name in scale.names]
    good &= valid[:, own].all(axis=1)
    features = scale.features(inputs[:, own], valid[:, own])
    loaded, missed = _learnt(told, x, features, good, settings, step_s)
    _, missed_without = _learnt(told, x, features[:, :0], good, settings, step_s)
    if loaded is None or float(np.mean(np.log(missed / missed_without))) > np.log(_LEAST_GAINED):
        return alone
    return replace(loaded, loads=scale, without_loads=alone)


def _learnt(
    names: tuple[str, ...],
    x: FloatArray,
    features: FloatArray,
    good: BoolArray,
    settings: SensorCheckSettings,
    step_s: float,
) -> tuple[SensorModel | None, FloatArray]:
    """The model learnt from rows (T, m) with features (T, F); and (m,) mean squares of each input's residual in
    left-out blocks, K²."""
    n, m = settings.window_steps, len(names)
    blocks = [slice(s, s + n) for s in range(len(x) % n, len(x), n) if good[s : s + n].mean() >= _LEAST_OF_BLOCK]
    apart = steps_in(_CHANGE_S, step_s)
    change, both = changes(x, good, apart)
    both = np.concatenate([np.zeros(apart, dtype=np.bool_), both])
    change = np.concatenate([np.zeros((apart, m)), change])
    driven = np.concatenate([np.zeros((apart, features.shape[1])), changes(features, good, apart)[0]])
    moving = [b for b in blocks if both[b].any()]  # with short steps the first ones have no row half an hour earlier
    if len(moving) < _LEAST_BLOCKS or m < 3:
        return None, np.empty(0)
    windows = _YEAR_S / step_s / n / settings.false_alarms_per_year
    level, variance, missed = _learn_view(x, features, good, blocks, windows=True)
    model = SensorModel(
        names=names,
        blocks=len(blocks),
        offset_std=np.sqrt(variance),
        offset_threshold=_OTHER_DAYS * _student_quantile(0.5 / (m * windows), _PRIOR_BLOCKS + len(blocks)),
        swap_threshold=float(np.log(m * (m - 1) / 2 * windows)),
        quietest_K=min(activity(change[b][both[b]]) for b in moving),
        level=level,
        change=_learn_view(change, driven, both, moving, windows=False)[0],
        step_s=step_s,
    )
    return model, missed


def _student_quantile(tail: float, freedom: float) -> float:
    from scipy.special import stdtrit  # the gateway itself only judges, and needs no SciPy

    return float(-stdtrit(freedom, tail))


def _learn_view(
    x: FloatArray, features: FloatArray, good: BoolArray, blocks: Sequence[slice], *, windows: bool
) -> tuple[View, FloatArray, FloatArray]:
    """The view; (m,) of each input's residual, K²: its variance while the others are as learnt, and its mean square.
    `windows`: of the blocks' means, not of rows."""
    m, worth = x.shape[1], _BLOCK_WORTH * len(blocks)
    singles, missed, pairs = np.zeros(m), np.zeros(m), np.zeros((3, m, m))
    for block in blocks:
        others = good.copy()
        others[block] = False
        heat = heat_of(features[others], x[others])
        precision = precision_of(_covariance(x[others] - heat.explained(features[others])))
        left_out, driven = x[block][good[block]] - x[others].mean(axis=0), features[block][good[block]]
        left_out = left_out - heat.explained(driven)
        if windows:
            left_out, driven = left_out.mean(axis=0, keepdims=True), driven.mean(axis=0, keepdims=True)
        new_loads = heat.leverage(driven)
        residual, leverage = leave_one_out(precision, left_out)
        missed += np.mean(residual**2, axis=0) / len(blocks)
        singles += np.mean(residual**2 / (1.0 + (leverage + new_loads) / worth), axis=0)
        for rows, new in zip(few_rows(left_out, m), few_rows(new_loads, m), strict=True):
            mine, other, leverage = leave_two_out(precision, rows)
            share = 1.0 / (1.0 + (leverage + new[:, :, None]) / worth) / len(left_out)
            pairs += [np.sum(v * share, axis=0) for v in (mine**2, other**2, mine * other)]
    weight = len(blocks) / (_PRIOR_BLOCKS + len(blocks))
    typical = float(np.median(pairs[0][~np.eye(m, dtype=np.bool_)]))
    pairs = (weight * pairs + (1.0 - weight) * np.array([typical, typical, 0.0])[:, None, None]) / len(blocks)
    variance: FloatArray = (weight * singles + (1.0 - weight) * float(np.median(singles))) / len(blocks)
    heat = heat_of(features[good], x[good])
    return (
        View(x[good].mean(axis=0), _covariance(x[good] - heat.explained(features[good])), pairs, heat),
        variance,
        missed,
    )


def changes(x: FloatArray, good: BoolArray, apart: int) -> tuple[FloatArray, BoolArray]:
    """(T - apart, m) changes between rows so many steps apart, and which of them (T - apart,) are between good rows."""
    return x[apart:] - x[:-apart], good[apart:] & good[:-apart]


def few_rows(x: FloatArray, inputs: int) -> Iterator[FloatArray]:
    """Rows (T, any) in portions whose pairs of inputs fit into the memory of a small computer."""
    portion = max(1, _MOST_AT_ONCE // inputs**2)
    for start in range(0, len(x), portion):
        yield x[start : start + portion]


def activity(change: FloatArray) -> float:
    """Root mean square of changes (T, m), K."""
    return float(np.sqrt(np.mean(change**2)))


def precision_of(covariance: FloatArray) -> FloatArray:
    """(m, m) inverse of the covariance with the sensors' noise on its diagonal."""
    return np.asarray(np.linalg.inv(covariance + _NOISE_K2 * np.eye(len(covariance))), dtype=np.float64)


def _covariance(x: FloatArray) -> FloatArray:
    centred = x - x.mean(axis=0)
    return np.asarray(centred.T @ centred / len(x))


def leave_one_out(precision: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(T, m) residual of each input against its prediction from the others, and the others' leverage; x centred."""
    r, own = x @ precision, np.diag(precision)
    leverage = np.sum(r * x, axis=1, keepdims=True) - r**2 / own
    return r / own, np.maximum(leverage, 0.0)


def leave_two_out(precision: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(T, m, m) of each pair i, j against its prediction from the rest: residual of i, of j, leverage of the rest."""
    r, own = x @ precision, np.diag(precision)
    determinant = own[:, None] * own[None, :] - precision**2
    np.fill_diagonal(determinant, 1.0)
    ri, rj = r[:, :, None], r[:, None, :]
    mine = (own[None, :] * ri - precision * rj) / determinant
    other = (own[:, None] * rj - precision * ri) / determinant
    leverage = np.sum(r * x, axis=1)[:, None, None] - mine * ri - other * rj
    return mine, other, np.maximum(leverage, 0.0)


def masked(names: Sequence[str], inputs: FloatArray, valid: BoolArray) -> tuple[FloatArray, BoolArray]:
    """Values with invalid ones set to 0, and a mask of the valid and possible ones. ValueError: shapes do not fit."""
    if inputs.ndim != 2 or inputs.shape[1] != len(names) or valid.shape != inputs.shape:
        raise ValueError(f"inputs {inputs.shape}, valid {valid.shape}: expected (T, {len(names)}), both")
    good: BoolArray = valid & (np.abs(inputs) <= LARGEST_INPUT)  # NaN compares false
    return np.where(good, inputs, 0.0), good
