"""The prior for a machine: what other machines of the same kind have learnt."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from talc.frame import FloatArray
from talc.learner.learner import TIME_CONSTANTS_S, LearnerState
from talc.learner.mixture import Mixture
from talc.learner.process import OtherMachines
from talc.names import THERMAL_ERRORS

_FORMAT = 1
_LAGS = len(TIME_CONSTANTS_S)
_POSTERIOR_SHARE = 0.5
"""Share of the mean posterior covariance; the variance between machines is added in full, on the diagonal."""
_ALONE = 0.25
"""Share of one machine's squared weights: how much another may differ, if only one is known."""
_LEAST_MEASUREMENTS = 12
_ZERO = 0.5
"""Probability from which a machine has found an error to be zero."""
_LARGEST = 1e12
"""Magnitude of a number in a file: the squares and sums of larger ones could overflow."""
_MOST_MACHINES = 1_000_000


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """Weights of the lags of inputs, for each error; matched by name."""

    inputs: tuple[str, ...]
    span: FloatArray
    """(n,) unit of each input's features."""
    machines: FloatArray
    """(9,) number of machines that know each error; 0: nothing is known."""
    mean: FloatArray
    """(9, n L) µm or µm/m per feature, input by input."""
    covariance: FloatArray
    """(9, n L, n L)"""

    def to_dict(self) -> dict[str, object]:
        """JSON-able; numbers to seven digits, covariances as lower triangles."""
        rows, columns = np.tril_indices(self.mean.shape[1])
        return {
            "format": _FORMAT,
            "time_constants_s": list(TIME_CONSTANTS_S),
            "inputs": list(self.inputs),
            "span": self.span.tolist(),
            "errors": {
                name: {
                    "machines": int(self.machines[j]),
                    "mean": _short(self.mean[j]),
                    "covariance": _short(self.covariance[j][rows, columns]),
                }
                for j, name in enumerate(THERMAL_ERRORS)
                if self.machines[j]
            },
        }

    @classmethod
    def from_dict(cls, plain: Mapping[str, object]) -> "Prior":
        """The inverse of `to_dict`. ValueError: names the field, its value and what was expected."""
        if plain.get("format") != _FORMAT:
            raise ValueError(f"format = {plain.get('format')!r}: expected {_FORMAT}")
        if plain.get("time_constants_s") != list(TIME_CONSTANTS_S):
            expected = ", ".join(f"{t:g}" for t in TIME_CONSTANTS_S)
            found = plain.get("time_constants_s")
            raise ValueError(f"time_constants_s = {found!r}: expected those of this program, {expected}")
        inputs, span = _inputs(plain.get("inputs")), plain.get("span")
        n = len(inputs) * _LAGS
        spans = _numbers(span, len(inputs), "span")
        for i in np.flatnonzero(spans <= 0.0):
            raise ValueError(f"span[{i}] = {spans[i]:g}: expected more than 0")
        machines, mean, covariance = np.zeros(9), np.zeros((9, n)), np.zeros((9, n, n))
        rows, columns = np.tril_indices(n)
        errors = plain.get("errors")
        if not isinstance(errors, dict) or not errors:
            raise ValueError("errors: expected a table of thermal errors")
        for name, stated in errors.items():
            if name not in THERMAL_ERRORS or not isinstance(stated, dict):
                raise ValueError(f"errors.{name}: expected a table under one of {', '.join(THERMAL_ERRORS)}")
            j, many = THERMAL_ERRORS.index(name), stated.get("machines")
            if not isinstance(many, int) or not 1 <= many <= _MOST_MACHINES:
                raise ValueError(f"errors.{name}.machines = {many!r}: expected a whole number, 1 to {_MOST_MACHINES}")
            machines[j] = many
            mean[j] = _numbers(stated.get("mean"), n, f"errors.{name}.mean")
            lower = _numbers(stated.get("covariance"), len(rows), f"errors.{name}.covariance")
            covariance[j][rows, columns] = covariance[j][columns, rows] = lower
            least, most = np.linalg.eigvalsh(covariance[j])[[0, -1]]
            if least < -1e-6 * max(most, 1.0):
                raise ValueError(f"errors.{name}.covariance: has a variance of {least:g}, expected none below 0")
        return cls(inputs, spans, machines, mean, covariance)

    def known(self, names: Sequence[str]) -> tuple[str, ...]:
        """The inputs among these that the other machines have too."""
        return tuple(name for name in names if name in self.inputs)

    def of(self, names: Sequence[str]) -> tuple[FloatArray, OtherMachines]:
        """For a machine with these inputs: (n,) spans, NaN where nothing is known, and the weights."""
        here = [self.inputs.index(name) if name in self.inputs else -1 for name in names]
        known = np.array([i >= 0 for i in here])
        span = np.where(known, self.span[here], np.nan)
        own = (np.array(here)[:, None] * _LAGS + np.arange(_LAGS)).ravel()
        mask = np.repeat(known, _LAGS)
        mean = np.where(mask, self.mean[:, own], 0.0)
        covariance = np.where(mask[:, None] & mask[None, :], self.covariance[:, own][:, :, own], 0.0)
        return span, OtherMachines(self.machines, mean, covariance)


def make_prior(learners: Sequence[tuple[Sequence[str], LearnerState]]) -> Prior:
    """From the inputs and states of learners on machines of one kind. ValueError: none has learnt anything.

    Mean: of the machines that have an input. Covariance: the variances between machines, and a share of the mean of
    what each machine itself is unsure of. An error that most machines found to be zero is left out: the next one
    would believe in it from the start.
    """
    names = tuple(dict.fromkeys(name for own, _ in learners for name in own))
    span = np.zeros(len(names))
    for own, state in learners:
        at = [names.index(name) for name in own]
        span[at] = np.maximum(span[at], state.span)
    n = len(names) * _LAGS
    machines, mean, covariance = np.zeros(9), np.zeros((9, n)), np.zeros((9, n, n))
    restored = [(own, state, _restored(state)) for own, state in learners]
    for j in range(9):
        learnt = [found for found in restored if found[1].mixture.count[j] >= _LEAST_MEASUREMENTS]
        believed = sum(mixture.share[j, 0] < _ZERO for _, _, mixture in learnt)
        if not learnt or 2 * believed < len(learnt):
            continue
        known = [_placed(own, state, mixture, j, names, span) for own, state, mixture in learnt]
        machines[j] = len(known)
        weights, present = np.array([w for w, _, _ in known]), np.array([m for _, _, m in known])
        count = np.maximum(present.sum(axis=0), 1)
        mean[j] = weights.sum(axis=0) / count
        between = np.where(present, weights - mean[j], 0.0) ** 2
        few = np.where(count > 1, between.sum(axis=0) / np.maximum(count - 1, 1), _ALONE * mean[j] ** 2)
        unsure = np.mean([p for _, p, _ in known], axis=0)
        covariance[j] = np.diag(few) + _POSTERIOR_SHARE * unsure
    if not machines.any():
        raise ValueError(
            f"no error was measured {_LEAST_MEASUREMENTS} times and found to be more than zero "
            f"by most of {len(learners)} machines"
        )
    return Prior(names, span, machines, mean, covariance)


def _placed(
    own: Sequence[str], state: LearnerState, mixture: Mixture, j: int, names: tuple[str, ...], span: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Weights, their covariance and which of them exist, among all names and in the common spans."""
    n = len(names) * _LAGS
    here = (np.array([names.index(name) for name in own])[:, None] * _LAGS + np.arange(_LAGS)).ravel()
    times = np.repeat(span[[names.index(name) for name in own]] / state.span, _LAGS)
    weights, covariance, present = np.zeros(n), np.zeros((n, n)), np.zeros(n)
    weights[here] = mixture.weights()[j] / mixture.believed[j] * times
    covariance[np.ix_(here, here)] = mixture.weight_covariance(j) * np.outer(times, times)
    present[here] = 1.0
    return weights, covariance, present


def _restored(state: LearnerState) -> Mixture:
    """ValueError: it began with a prior itself."""
    mixture = Mixture(len(state.span), _LAGS, 300.0)
    mixture.restore(state.mixture)
    return mixture


def _inputs(value: object) -> tuple[str, ...]:
    if not isinstance(value, list) or not value or not all(isinstance(name, str) for name in value):
        raise ValueError("inputs: expected a list of names")
    for name in value:
        if value.count(name) > 1:
            raise ValueError(f"inputs: {name!r} occurs twice")
    return tuple(value)


def _numbers(value: object, size: int, name: str) -> FloatArray:
    if not isinstance(value, list) or len(value) != size:
        found = f", found {len(value)}" if isinstance(value, list) else ""
        raise ValueError(f"{name}: expected a list of {size} numbers{found}")
    for i, number in enumerate(value):
        if isinstance(number, bool) or not isinstance(number, int | float) or not abs(number) <= _LARGEST:
            raise ValueError(f"{name}[{i}] = {number!r}: expected a number, at most {_LARGEST:g} in magnitude")
    return np.array(value, dtype=np.float64)


def _short(values: FloatArray) -> list[float]:
    return [float(f"{v:.7g}") for v in values]
