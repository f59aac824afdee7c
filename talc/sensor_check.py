"""The sensor check: has a sensor acquired an offset, or have two been exchanged, since they were learnt?

Hypotheses about the last window, each against "nothing happened":

- offset of input i: Student's t of the window's mean residual (talc.sensor_model);
- i and j exchanged: the likelihood ratio of the pair's residuals as they are and exchanged, of the window's mean and of
  half-hourly changes. An exchange adds no parameter: by Markov's inequality a ratio of c or more comes by chance with
  probability 1 / c at most.

What known loads explain is no residual (talc.load_heat). A residual that other loads than the learnt ones may explain
is doubted: its variance grows with the leverage of the other inputs and of the loads, without those being judged.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, Literal

import numpy as np

from talc.frame import BoolArray, FloatArray
from talc.load_heat import HISTORY_S
from talc.sensor_model import (
    SensorModel,
    View,
    activity,
    changes,
    few_rows,
    leave_one_out,
    leave_two_out,
    masked,
    precision_of,
)
from talc.settings import SensorCheckSettings
from talc.steps import HOUR_S, steps_in

_LEAST_OF_WINDOW: Final = 0.5
_CORRELATED_S: Final = HOUR_S
"""Successive half-hourly changes overlap and err alike: those of an hour count as one."""
_EQUAL: Final = 2.0
"""Explanations with log-likelihoods closer than this cannot be distinguished."""
_MOST_FINDINGS: Final = 4


@dataclass(frozen=True, slots=True)
class Finding:
    """One explanation that fits the window better than no fault does."""

    kind: Literal["offset", "swap"]
    inputs: tuple[str, ...]
    """The input with the offset, or the two that are exchanged."""
    offset_K: float  # noqa: N815
    """Estimate of an offset. NaN for an exchange."""
    score: float
    """How far the evidence goes beyond the threshold: 1 is just enough."""
    alternatives: tuple[str, ...] = ()
    """For an offset: other inputs that would explain it equally well."""


@dataclass(frozen=True, slots=True)
class Judgement:
    """The judgement of one window."""

    findings: tuple[Finding, ...] = ()
    """The strongest first."""
    smallest_offset_K: Mapping[str, float] = field(default_factory=dict)  # noqa: N815
    """Input to the offset that this window would have shown. Inputs that could not be judged are missing."""
    alike: tuple[tuple[str, str], ...] = ()
    """Pairs that could be exchanged unnoticed in this window: sensors side by side, or a machine at rest."""
    loads: tuple[str, ...] = ()
    """Loads from which the inputs were predicted, beside each other."""


def rows_needed(model: SensorModel, settings: SensorCheckSettings) -> int:
    """Number of rows that a judgement looks at; with fewer the lags of loads begin later."""
    history = 0 if model.loads is None else steps_in(HISTORY_S, model.step_s)
    return settings.window_steps + model.change_steps + history


def judge(
    model: SensorModel, names: Sequence[str], inputs: FloatArray, valid: BoolArray, settings: SensorCheckSettings
) -> Judgement:
    """Explanations of the last window that fit better than no fault; each is removed before the next is searched.

    inputs: (T, m) consecutive grid steps, as long as the model's, degC, loads in their own units, the window last;
    valid: (T, m). Inputs that the model does not know, or with less than half a window of good rows, are left out. So
    are all loads, if one of them is known for less than half a window. Less than half a window is not judged, nor a
    window quieter than all that were learnt: how a machine settles at rest was not learnt.
    """
    inputs, valid = masked(names, inputs, valid)
    n = settings.window_steps
    known = {name: i for i, name in enumerate(names)}
    present = [name for name in model.names if name in known and valid[-n:, known[name]].mean() >= _LEAST_OF_WINDOW]
    columns = [known[name] for name in present]
    good = np.asarray(valid[:, columns].all(axis=1), dtype=np.bool_)
    features = np.empty((len(inputs), 0))
    if model.loads is not None:
        driving = [known[name] for name in model.loads.names if name in known]
        loaded = np.asarray(valid[:, driving].all(axis=1), dtype=np.bool_)
        if len(driving) == len(model.loads.names) and (good & loaded)[-n:].mean() >= _LEAST_OF_WINDOW:
            features, good = model.loads.features(inputs[:, driving], valid[:, driving]), good & loaded
        else:
            model = model.without_loads or model
    last = slice(-n - model.change_steps, None)
    x, features, good = inputs[last][:, columns], features[last], good[last]
    if len(x) < n or len(present) < 3 or good[-n:].mean() < _LEAST_OF_WINDOW:
        return Judgement()
    change, both = changes(x, good, model.change_steps)
    if not both.any() or activity(change[both]) < model.quietest_K:
        return Judgement()
    window = _JudgedWindow(model.part(present), x, features, good, settings)
    smallest, alike = window.smallest_offset_K(), window.alike()
    found: list[Finding] = []
    while len(found) < min(_MOST_FINDINGS, len(present) - 2) and (best := window.best()) is not None:
        found.append(best)
        window = window.after(best)
    return Judgement(tuple(found), smallest, alike, () if model.loads is None else model.loads.names)


class _JudgedWindow:
    """One window of m >= 3 inputs under all hypotheses."""

    def __init__(
        self, model: SensorModel, x: FloatArray, features: FloatArray, good: BoolArray, settings: SensorCheckSettings
    ) -> None:
        self._model, self._x, self._features, self._good, self._settings = model, x, features, good, settings
        n = settings.window_steps
        mean = x[-n:][good[-n:]].mean(axis=0, keepdims=True)
        driving = features[-n:][good[-n:]].mean(axis=0, keepdims=True)
        precision = precision_of(model.level.covariance)
        residual, leverage = leave_one_out(precision, model.level.off(mean, driving))
        leverage = leverage + model.level.heat.leverage(driving)
        self._residual, self._std = residual[0], model.offset_std * np.sqrt(1.0 + leverage[0] / model.worth)
        self._ratio, left = _exchange(model, model.level, precision, mean, driving, 1.0)
        self._healed = left <= model.offset_threshold**2
        change, both = changes(x, good, model.change_steps)
        if both.any():
            change, driven = change[both], changes(features, good, model.change_steps)[0][both]
            precision, count = (
                precision_of(model.change.covariance),
                len(change) / steps_in(_CORRELATED_S, model.step_s),
            )
            self._ratio += _exchange(model, model.change, precision, change, driven, count)[0]
        self._largest_ratio, self._largest_score = model.swap_threshold, model.offset_threshold

    def smallest_offset_K(self) -> dict[str, float]:
        return dict(zip(self._model.names, (self._largest_score * self._std).tolist(), strict=True))

    def alike(self) -> tuple[tuple[str, str], ...]:
        """If two inputs had been exchanged, their ratio would have been the inverse of this."""
        names = self._model.names
        pairs = zip(*np.nonzero(np.isfinite(self._ratio) & (-self._ratio <= self._largest_ratio)), strict=True)
        return tuple((names[i], names[j]) for i, j in pairs)

    def best(self) -> Finding | None:
        """The strongest explanation that exceeds its threshold. An exchange goes first, because it has no parameter.

        It must leave nothing to explain; otherwise a large offset would look like an exchange with a warmer neighbour.
        """
        names = self._model.names
        ratio = np.where(self._healed, self._ratio, -np.inf)
        i, j = (int(v) for v in np.unravel_index(np.argmax(ratio), ratio.shape))
        if ratio[i, j] > self._largest_ratio:
            return Finding("swap", (names[i], names[j]), float("nan"), float(ratio[i, j] / self._largest_ratio))
        score = self._residual / self._std
        first = int(np.argmax(np.abs(score)))
        if abs(score[first]) <= self._largest_score:
            return None
        freedom = self._model.freedom
        likelihood = (freedom + 1.0) / 2.0 * np.log1p(score**2 / freedom)
        equal = tuple(names[k] for k in range(len(names)) if k != first and likelihood[k] > likelihood[first] - _EQUAL)
        beyond = float(abs(score[first]) / self._largest_score)
        return Finding("offset", (names[first],), float(self._residual[first]), beyond, equal)

    def after(self, finding: Finding) -> "_JudgedWindow":
        """The window with the finding undone: exchanged back, or without the input that has the offset."""
        places = [self._model.names.index(name) for name in finding.inputs]
        if finding.kind == "swap":
            back = self._x.copy()
            back[:, places] = back[:, places[::-1]]
            return _JudgedWindow(self._model, back, self._features, self._good, self._settings)
        x: FloatArray = np.delete(self._x, places, axis=1)
        rest = [name for name in self._model.names if name not in finding.inputs]
        return _JudgedWindow(self._model.part(rest), x, self._features, self._good, self._settings)


def _exchange(
    model: SensorModel, view: View, precision: FloatArray, x: FloatArray, features: FloatArray, count: float
) -> tuple[FloatArray, FloatArray]:
    """From rows (T, m) with features (T, F), worth `count`, (m, m) each: log-likelihood ratio of i and j exchanged,
    Student's, -inf where i >= j; and the squared distance from the rest that the exchange leaves."""
    as_it_is, exchanged = np.zeros((2, *precision.shape))
    m = len(precision)
    for rows, driving in zip(few_rows(x, m), few_rows(features, m), strict=True):
        mine, other, leverage = leave_two_out(precision, view.off(rows, driving))
        gap = rows[:, None, :] - rows[:, :, None]
        share = count / len(x) / (1.0 + (leverage + view.heat.leverage(driving)[:, :, None]) / model.worth)
        as_it_is += np.sum(_distance(view.pairs, mine, other) * share, axis=0)
        exchanged += np.sum(_distance(view.pairs, mine + gap, other - gap) * share, axis=0)
    gained = np.log1p(as_it_is / model.freedom) - np.log1p(exchanged / model.freedom)
    ratio = (model.freedom + 2.0 * count) / 2.0 * gained
    return np.where(np.triu(np.ones(ratio.shape, dtype=np.bool_), 1), ratio, -np.inf), exchanged


def _distance(pairs: FloatArray, mine: FloatArray, other: FloatArray) -> FloatArray:
    """Squared Mahalanobis distance of pairs of residuals."""
    a, b, c = pairs
    with np.errstate(divide="ignore", invalid="ignore"):  # the diagonal is not a pair
        return np.asarray((b * mine**2 - 2.0 * c * mine * other + a * other**2) / (a * b - c**2))
