"""The experts of all thermal errors: Kalman filters of weights, mixed by how well they predict measurements."""

from copy import deepcopy
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from talc.frame import FloatArray
from talc.learner import filters
from talc.learner.experts import EXPERTS, OTHERS_EXPERTS, UNIT, Expert
from talc.names import THERMAL_ERRORS

_ERRORS = len(THERMAL_ERRORS)
_DRIFT_STEP_S = 300.0
"""Time in seconds to which the drifts of an `Expert` refer."""
_TEMPER = 0.6
"""Exponent of the likelihoods."""
_KEPT = 0.97
"""Discount of the likelihoods at each measurement."""
_SHARED = 0.01
"""Share of the weight that is spread over all experts."""
_NULL_FIRST = 3.0
"""First log-odds that an error stays zero."""
_NULL_KEPT = 0.995
"""Their discount at a measurement."""
_NULL_BOUND = 10.0
"""Their bound."""
_REFERENCE = 0.2
"""Variance of the reference's noise over a measurement's: by default the reference is a mean of five."""
_OTHERS_SHARE = 0.8
"""First weight of all experts from other machines together."""
_OTHERS_NULL = -2.0
"""First log-odds that an error stays zero of which other machines have learnt."""
_LEAST_NOISE = 0.25
"""µm or µm/m: no probing cycle is more accurate."""
_FAR = 5.0
"""Standard deviations from which a measurement may be an outlier. It is one only if it is also that far from the last
measurement of an error that changes by `_FASTEST`: a machine that starts to behave differently gives surprising
measurements, which must be learnt."""
_OUTLIER_AS = 2.5
"""The noise of an outlier is enlarged until it is this many standard deviations off."""
_FASTEST = 0.3
"""UNIT in 5 min."""
_FIRST_FAR = 4.0
"""If the first measurement is this many standard deviations from zero, the reference is not the present state."""
_LEAST_MIXED = 1e-3
_RENEWED = 8
"""Number of inputs for which a measurement renews the prior variance."""
_EVIDENCE_FROM = 6
"""Measurements before the first renewal."""
_EVIDENCE = np.array([0.5, 0.1, 0.1, 3.0, 1e-4, 1e2])
"""Weights that the variance before counts for; a smaller relative change is not made; bounds of a change, and of a
variance over its first one."""
_LARGE = "covariance", "mixed"
"""Parts of a state that grow with the square of the number of inputs."""


@dataclass(slots=True, eq=False)
class MixtureState:
    """The whole state. E experts, n weights, the last two the level and the reference's noise; m = n (n + 1) / 2."""

    mean: FloatArray
    """(9, E, n) µm or µm/m per feature."""
    covariance: FloatArray
    """(9, E, m) lower triangles."""
    prior: FloatArray
    """(9, E, n) variance of each weight a priori."""
    log_weight: FloatArray
    """(9, E) of the experts; `weight` (9, E) the same, normalised."""
    weight: FloatArray
    mixed: FloatArray
    """(9, m) weighted sum of the covariances; `drift` (9, n) of the drifts."""
    drift: FloatArray
    elapsed: FloatArray
    """(9,) steps since the last measurement of each error."""
    level_variance: FloatArray
    """(9,) variance that gaps have added to the level since then."""
    null: FloatArray
    """(9,) log-odds that the error stays zero."""
    shift: FloatArray
    """(9, 2) mean and variance of the reference's noise, if the error stays zero."""
    count: NDArray[np.int64]
    """(9,) measurements so far."""
    suspect: FloatArray
    """(9,) the last innovation, if it was an outlier; else 0."""
    last: FloatArray
    """(9,) the last measurement that was not an outlier; NaN before the first."""
    cursor: int
    """The next input to be renewed."""


@dataclass(frozen=True, slots=True, eq=False)
class Surprise:
    """How a measurement compared with its prediction, per error; NaN where not measured."""

    ratio: FloatArray
    """(9,) innovations over their standard deviations."""
    outlier: NDArray[np.bool_]
    """(9,) treated as an outlier: it has little effect."""
    jump: NDArray[np.bool_]
    """(9,) the second far measurement in a row: the level starts again."""


@dataclass(frozen=True, slots=True, eq=False)
class OtherMachines:
    """What other machines have learnt, in the order of this machine's inputs."""

    machines: FloatArray
    """(9,) number of machines that know each error."""
    mean: FloatArray
    """(9, n) weights of the inputs."""
    covariance: FloatArray
    """(9, n, n); variance 0: an input that they do not have."""


class Mixture:
    """Errors, each with the same experts; 9 in the shapes below stands for their number.

    y[k] = phi[k]' w[k] + b[k] + c + e, with w and b random walks; the features phi come from outside. The level b is 0
    at the reference; c is the noise of the reference, which every measurement contains and the error does not. Every
    expert is a Kalman filter of (w, b, c). A prediction is of the error, so without c: the mean of the experts',
    weighted by the product of their predictive likelihoods, tempered and discounted, with a fixed share (Herbster and
    Warmuth, Machine Learning 32 (1998) 151-178). Beside them stands the hypothesis that the error is zero at all times:
    measured are then c and e. In the shapes of the methods n is the number of features, the last of which is 1, for the
    level; a state has one weight more, c.

    Experts with `evidence` renew each input's prior variance at measurements by MacKay's fixed point (Neural
    Computation 4 (1992) 415-447), v = sum(m²) / sum(1 - P / v) over the input's weights, and condition on the change.

    Parameters
    ----------
    inputs, lags: features are inputs times lags, input by input
    step_s: grid step
    experts: of each error
    others: what other machines have learnt; adds experts that start with it
    errors: number of errors; nine unless stated
    """

    def __init__(
        self,
        inputs: int,
        lags: int,
        step_s: float,
        experts: tuple[Expert, ...] = EXPERTS,
        others: OtherMachines | None = None,
        errors: int = _ERRORS,
    ) -> None:
        self._errors = errors
        experts = experts if others is None else (*experts, *OTHERS_EXPERTS)
        self._others, self._started_from_others = others, [e for e, expert in enumerate(experts) if expert.others]
        self._inputs, self._lags, self._experts = inputs, lags, experts
        self._level = level = inputs * lags
        n, many = level + 2, len(experts)
        self._n, packed = n, n * (n + 1) // 2
        self._diagonal = np.arange(n) * (np.arange(n) + 3) // 2
        self._evidence = np.flatnonzero([expert.evidence for expert in experts])
        unit = UNIT**2 / max(level, 1)
        prior, growth = np.zeros((many, n)), np.zeros((many, n))
        for e, expert in enumerate(experts):
            prior[e, :level] = expert.weight**2 * unit
            growth[e, :level] = expert.drift**2 * unit
            if expert.direct:
                lagged = np.arange(level) % lags > 0
                prior[e, :level] = np.where(lagged, 0.0, lags * prior[e, :level])
                growth[e, :level] = np.where(lagged, 0.0, lags * growth[e, :level])
            growth[e, level] = (expert.level * UNIT) ** 2
        self._per_step = step_s / _DRIFT_STEP_S
        self._growth = growth * self._per_step
        self._misfit = np.array([(expert.misfit * UNIT) ** 2 for expert in experts])
        """(E,) variances."""
        self._first_prior = prior
        self._groups = np.arange(min(_RENEWED, inputs))
        self._gain, self._spread = np.empty((many, n)), np.empty(many)
        weight, null = np.full((self._errors, many), 1.0 / many), np.full(self._errors, _NULL_FIRST)
        if others is not None:
            known, added = others.machines > 0, len(self._started_from_others)
            weight[known] = (1.0 - _OTHERS_SHARE) / (many - added)
            weight[known, many - added :] = _OTHERS_SHARE / added
            null[known] = _OTHERS_NULL
        self._s = MixtureState(
            mean=np.zeros((self._errors, many, n)),
            covariance=np.zeros((self._errors, many, packed)),
            prior=np.repeat(prior[None], self._errors, axis=0),
            log_weight=np.log(weight),
            weight=weight,
            mixed=np.zeros((self._errors, packed)),
            drift=np.zeros((self._errors, n)),
            elapsed=np.zeros(self._errors),
            level_variance=np.zeros(self._errors),
            null=null,
            shift=np.zeros((self._errors, 2)),
            count=np.zeros(self._errors, dtype=np.int64),
            suspect=np.zeros(self._errors),
            last=np.full(self._errors, np.nan),
            cursor=0,
        )

    @property
    def count(self) -> NDArray[np.int64]:
        """(9,) measurements of each error so far."""
        return self._s.count

    @property
    def weight(self) -> FloatArray:
        """(9, E) of the experts."""
        return self._s.weight

    @property
    def believed(self) -> FloatArray:
        """(9,) probability that an error is not just zero."""
        return np.asarray(1.0 / (1.0 + np.exp(self._s.null)), dtype=np.float64)

    def weights(self) -> FloatArray:
        """(9, n) means of the mixtures: of the features' weights, and the level."""
        mean = self._s.mean[:, :, : self._level + 1]
        return np.asarray(np.einsum("je,jen->jn", self._s.weight, mean), dtype=np.float64)

    def variances(self) -> FloatArray:
        """(9, n) of the weights and the level, by themselves: within the experts and between them."""
        s, used = self._s, self._level + 1
        apart = np.einsum("je,jen->jn", s.weight, (s.mean[:, :, :used] - self.weights()[:, None]) ** 2)
        own = s.mixed[:, self._diagonal[:used]] + s.drift[:, :used] * s.elapsed[:, None]
        own[:, -1] += s.level_variance
        return np.asarray(own + apart, dtype=np.float64)

    def state(self) -> MixtureState:
        """A copy."""
        return _copy_of(self._s)

    def restore(self, state: MixtureState) -> None:
        """Continue from a state. ValueError: it has other inputs or experts."""
        if state.mean.shape != self._s.mean.shape:
            raise ValueError(f"mean {state.mean.shape}: expected {self._s.mean.shape}")
        self._s = _copy_of(state)

    def elapse(self, steps: int) -> None:
        """Let this many steps pass."""
        self._s.elapsed += steps

    def add_level_variance(self, variance: FloatArray) -> None:
        """(9,) variances by which the levels may have changed."""
        self._s.level_variance += variance

    def predict(self, x: FloatArray, ahead: int = 0) -> tuple[FloatArray, FloatArray]:
        """(9,) means and variances with features x (n,), `ahead` steps from now, the hypothesis of zero left aside.
        Before the first measurement of an error: 0 and 0."""
        return self._predict(np.append(x, 0.0), ahead)

    def expect(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(9,) means and variances of what a measurement now would show, its own noise aside."""
        return self._predict(np.append(x, 1.0), 0)

    def _predict(self, x: FloatArray, ahead: int) -> tuple[FloatArray, FloatArray]:
        s, mean, variance = self._s, np.zeros(self._errors), np.zeros(self._errors)
        if not s.count.any():  # with many inputs, even zeros take long to read
            return mean, variance
        filters.predict(s.mean, s.weight, s.mixed, s.drift, s.elapsed + ahead, x, mean, variance)
        return mean, variance + s.level_variance + np.where(s.count > 0, s.weight @ self._misfit, 0.0)

    def each(self, x: FloatArray) -> FloatArray:
        """(9, E) what each expert predicts with features x (n,)."""
        return np.asarray(self._s.mean[:, :, :-1] @ x, dtype=np.float64)

    def covariance(self, x: FloatArray, others: FloatArray) -> FloatArray:
        """(9, S) between a measurement now with features x (n,), and the errors with others (S, n)."""
        s, x = self._s, np.append(x, 1.0)
        if not s.count.any():
            return np.zeros((self._errors, len(others)))
        growth = s.drift * s.elapsed[:, None]
        growth[:, self._level] += s.level_variance
        gain = np.empty_like(growth)
        filters.gain(s.mixed, x, gain)
        gain += growth * x
        here, there = s.mean @ x, s.mean[:, :, :-1] @ others.T
        apart = here - np.sum(s.weight * here, axis=1)[:, None]
        return np.asarray(gain[:, :-1] @ others.T + np.einsum("je,jes->js", s.weight * apart, there), dtype=np.float64)

    def widen(self, factor: FloatArray) -> None:
        """(inputs,) features became this much smaller, and so must their weights become larger; but a priori they are
        in the new unit what they were in the old one."""
        s, lags = self._s, self._lags
        times, first = np.append(np.repeat(factor, lags), [1.0, 1.0]), np.flatnonzero(factor > 1.0) * lags
        for j in np.flatnonzero(s.count):
            variance = s.prior[j][:, first]
            which, g = np.nonzero(variance)
            more = (1.0 - 1.0 / factor[first[g] // lags] ** 2) / variance[which, g]
            own = s.covariance[j], s.mean[j], times, which, first[g], lags, more
            filters.rescale(*own, s.weight[j], _LEAST_MIXED, s.mixed[j])

    def learn(self, x: FloatArray, errors: FloatArray, sigma: FloatArray, doubt: FloatArray) -> Surprise:
        """Take in a measurement: (9,) errors, NaN where there is none, and their standard uncertainties.

        doubt: (9,) variance that missing inputs add to a prediction.
        """
        measured = np.append(x, 1.0)
        ratio = np.full(self._errors, np.nan)
        outlier, jump = np.zeros((2, self._errors), dtype=np.bool_)
        for j in np.flatnonzero(np.isfinite(errors)):
            noise = max(float(sigma[j]), _LEAST_NOISE) ** 2 + float(doubt[j])
            ratio[j], outlier[j], jump[j] = self._learn_one(int(j), measured, float(errors[j]), noise)
        self._s.cursor = (self._s.cursor + _RENEWED) % max(self._inputs, 1)
        return Surprise(ratio, outlier, jump)

    def _learn_one(self, j: int, x: FloatArray, y: float, noise: float) -> tuple[float, bool, bool]:
        s = self._s
        covariance, mean, gain, spread = s.covariance[j], s.mean[j], self._gain, self._spread
        if s.count[j] == 0:
            self._begin(j, y, noise)
        growth = self._growth * s.elapsed[j]
        growth[:, self._level] += s.level_variance[j]
        filters.look(covariance, growth, x, gain, spread)
        spread += self._misfit  # noise of the filter's own: the kernel needs the sum of both
        innovation = y - np.sum(mean * x, axis=1)
        weight = s.weight[j]
        centre = float(weight @ innovation)
        total = float(weight @ (spread + (innovation - centre) ** 2)) + noise
        ratio = centre / np.sqrt(total)
        self._weigh_null(j, y, centre, total, noise)
        outlier = jump = False
        change = 2.0 * noise + (_FASTEST * UNIT) ** 2 * s.elapsed[j] * self._per_step
        if abs(ratio) > _FAR and (y - s.last[j]) ** 2 > _FAR**2 * change:  # NaN compares false
            jump = s.suspect[j] * centre > 0.0
            outlier = not jump
        s.suspect[j] = centre if outlier else 0.0
        if not outlier:
            s.last[j] = y
        if jump:
            covariance[:, self._diagonal[self._level]] += centre**2
            gain[:, self._level] += centre**2
            spread += centre**2
        elif outlier:
            noise += (centre / _OUTLIER_AS) ** 2 - total
        likelihood = -0.5 * (np.log(spread + noise) + innovation**2 / (spread + noise))
        log_weight = _KEPT * (s.log_weight[j] - s.log_weight[j].max()) + _TEMPER * likelihood
        weight = np.exp(log_weight - log_weight.max())
        weight = (1.0 - _SHARED) * weight / weight.sum() + _SHARED / len(weight)
        s.weight[j], s.log_weight[j] = weight, np.log(weight)
        s.count[j] += 1
        s.elapsed[j] = s.level_variance[j] = 0.0
        renewed = self._evidence if s.count[j] >= _EVIDENCE_FROM else self._evidence[:0]
        groups = (s.cursor + self._groups) % max(self._inputs, 1)
        filters.learn(
            covariance,
            mean,
            *(gain, spread, innovation, noise),
            *(s.prior[j], self._first_prior),
            renewed,
            groups,
            self._lags,
            _EVIDENCE,
            weight,
            _LEAST_MIXED,
            s.mixed[j],
        )
        s.drift[j] = np.sum(weight[:, None] * self._growth, axis=0)
        return ratio, outlier, jump

    def _begin(self, j: int, y: float, noise: float) -> None:
        """Errors are deviations from the reference: the level starts at zero, unless the first measurement is so far
        off that the reference is not the present state."""
        s = self._s
        s.covariance[j][:, self._diagonal] = s.prior[j]
        if self._others is not None and self._others.machines[j]:
            for e in self._started_from_others:
                self._start_from_others(j, e, self._others)
        s.shift[j] = 0.0, _REFERENCE * noise
        s.covariance[j][:, self._diagonal[self._level]] = y * y if abs(y) > _FIRST_FAR * np.sqrt(noise) else 0.0
        s.covariance[j][:, self._diagonal[-1]] = _REFERENCE * noise
        s.elapsed[j] = s.level_variance[j] = 0.0

    def _start_from_others(self, j: int, e: int, others: OtherMachines) -> None:
        """An expert starts with what other machines learnt; for inputs that they do not have, with the flat prior."""
        s, size = self._s, self._level
        variance = np.diag(others.covariance[j])
        own = np.where(variance > 0.0, variance, UNIT**2 / size) * self._experts[e].weight ** 2
        full = np.zeros((self._n, self._n))
        full[:size, :size] = others.covariance[j] * self._experts[e].weight ** 2
        full[np.arange(size), np.arange(size)] = own
        s.covariance[j, e] = full[np.tril_indices(self._n)]
        s.mean[j, e, :size] = others.mean[j]
        s.prior[j, e, :size] = np.repeat(own.reshape(-1, self._lags).mean(axis=1), self._lags)

    def _weigh_null(self, j: int, y: float, centre: float, total: float, noise: float) -> None:
        """The hypothesis of zero against the mixture; an outlier of both says little of either."""
        far, (mean, variance) = _FAR * _FAR, self._s.shift[j]
        from_zero, spread = y - mean, variance + noise
        distance, expected = from_zero**2 / spread, centre * centre / total
        zero = -0.5 * (np.log(spread) + (distance if expected < far else min(distance, far)))
        other = -0.5 * (np.log(total) + min(expected, far))
        odds = _NULL_KEPT * self._s.null[j] + zero - other
        self._s.null[j] = min(max(odds, -_NULL_BOUND), _NULL_BOUND)
        if distance < far:
            self._s.shift[j] = mean + variance / spread * from_zero, variance * noise / spread


def mixture_bytes(inputs: int, lags: int) -> int:
    """The most memory that a mixture of nine errors takes, from their first measurements on."""
    n = inputs * lags + 2
    return _ERRORS * (len(EXPERTS) + 1) * (n * (n + 1) // 2) * np.dtype(np.float64).itemsize


def _copy_of(state: MixtureState) -> MixtureState:
    """A copy. The large parts of errors that were never measured are zero, and are not copied: with many inputs they
    are gigabytes, and zeros that nobody has written take no memory."""
    own = {field.name: deepcopy(getattr(state, field.name)) for field in fields(state) if field.name not in _LARGE}
    for name in _LARGE:
        large = getattr(state, name)
        own[name] = np.zeros(large.shape)
        for j in np.flatnonzero(state.count):
            own[name][j] = large[j]
    return MixtureState(**own)
