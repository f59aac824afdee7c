"""The experts of all thermal errors: Gaussian processes, mixed by how well they predict measurements."""

import numpy as np
from numpy.typing import NDArray

from talc.frame import FloatArray
from talc.learner.experts import EXPERTS, OTHERS_EXPERTS, UNIT, Expert
from talc.learner.process import NEWEST, OTHER_REFERENCE, OtherMachines, Process, Rows
from talc.learner.told import MeasurementFault, MixtureState, Surprise
from talc.names import THERMAL_ERRORS

_ERRORS = len(THERMAL_ERRORS)
_DRIFT_STEP_S = 300.0
"""Time in seconds to which the level of an `Expert` refers."""
_TEMPER = 0.6
"""Exponent of the likelihoods."""
_KEPT = 0.97
"""Discount of the likelihoods at each measurement."""
_SHARED = 0.003
"""Share of the weight that every expert keeps of its first one."""
_ZERO = 0.9
"""First weight of zero: an error is believed when measurements show it."""
_REFERENCE = 0.2
"""Variance of the reference's noise over a measurement's: by default the reference is a mean of five."""
_OTHERS_SHARE = 0.8
"""First weight of all experts from other machines together; then that of zero is `_OTHERS_ZERO`."""
_OTHERS_ZERO = 0.1
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
_TWICE_OFF = 2.0
"""If two measurements in a row are so many standard deviations off to the same side, the level is moving fast."""
_RIGHT = 2.0
"""A far measurement that is within so many standard deviations of what was predicted before the level moved far takes
that back: measurements of a bad day, stuck or in another unit, are no change of the machine."""
_TAKEN_BACK_S = 86400.0
"""The longest such day. It has no more measurements than are never merged."""
_FIRST_FAR = 4.0
"""If the first measurement is this many standard deviations from zero, the reference is not the present state."""
_EVIDENCE_FROM = 6
"""Measurements before the first renewal of prior variances."""
_RENEWAL_COST = 3e6
"""Rows cubed for which a measurement renews prior variances: those of all errors at first, of one in turn later."""
_TIMES = {MeasurementFault.THOUSANDTH: 1e-3, MeasurementFault.THOUSANDFOLD: 1e3}


class Mixture:
    """Errors, each with the same experts; 9 in the shapes below stands for their number.

    Every expert but one is a Gaussian process (`talc.learner.process`); the other one says that the error is zero at
    all times. A prediction is the experts' mean, weighted by their first weights and the product of their predictive
    likelihoods, tempered and discounted. So an estimate is shrunk towards zero by the probability that the error just
    is zero. Its uncertainty is that of the processes alone: that an error cannot be shown does not make it zero.

    Measured are the error, the noise of the reference, which every measurement contains, and a measurement's own noise.

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
        experts = experts if others is None else (*experts, *OTHERS_EXPERTS)
        self._errors, self._inputs, self._features = errors, inputs, inputs * lags
        self._per_step = step_s / _DRIFT_STEP_S
        self._rows = Rows(self._features, errors)
        self._processes = [Process(expert, self._rows, inputs, others) for expert in experts]
        self._misfit = np.array([0.0, *((expert.misfit * UNIT) ** 2 for expert in experts)])
        self._first = np.full((errors, len(experts) + 1), (1.0 - _ZERO) / len(experts))
        self._first[:, 0] = _ZERO
        if others is not None:
            known, added = others.machines > 0, len(OTHERS_EXPERTS)
            self._first[:, -added:] = 0.0
            self._first[:, 1:-added] = (1.0 - _ZERO) / (len(experts) - added)
            self._first[known, 0], self._first[known, -added:] = _OTHERS_ZERO, _OTHERS_SHARE / added
            self._first[known, 1:-added] = (1.0 - _OTHERS_ZERO - _OTHERS_SHARE) / (len(experts) - added)
        self._evidence, self._zero = np.zeros_like(self._first), np.zeros((errors, 4))
        self._share = self._shares()
        self._now, self._jolted, self._elapsed = 0.0, np.zeros(errors), np.zeros(errors)
        self._count, self._cursor = np.zeros(errors, dtype=np.int64), 0
        self._suspect, self._off = np.zeros((2, errors))
        self._last = np.full(errors, np.nan)
        self._reference, self._references = np.zeros(errors), 0
        self._before, self._refused = np.full(errors, -1, dtype=np.int64), np.full(errors, np.nan)
        self._former_jolted, self._former_last = np.zeros((2, errors))
        self._former_evidence, self._former_zero = np.zeros_like(self._evidence), np.zeros_like(self._zero)
        self._weights: FloatArray | None = None

    @property
    def count(self) -> NDArray[np.int64]:
        """(9,) measurements of each error so far."""
        return self._count

    @property
    def share(self) -> FloatArray:
        """(9, E + 1) weight of zero, and of each process."""
        return self._share

    @property
    def believed(self) -> FloatArray:
        """(9,) probability that an error is not just zero."""
        return 1.0 - self._share[:, 0]

    def weights(self) -> FloatArray:
        """(9, p) mean linear weights of the features."""
        if self._weights is None:
            each = np.stack([process.weights() for process in self._processes], axis=1)
            self._weights = np.einsum("je,jep->jp", self._share[:, 1:], each)
        return self._weights

    def variances(self) -> FloatArray:
        """(9, p) of the linear weights, by themselves: within the processes and between them, and zero."""
        each = np.stack([process.weights() for process in self._processes], axis=1)
        within = np.array([[np.diag(one.weight_covariance(j)) for one in self._processes] for j in range(self._errors)])
        mean, share = self.weights(), self._share[:, 1:]
        return np.asarray(np.einsum("je,jep->jp", share / self.believed[:, None], within + (each - mean[:, None]) ** 2))

    def weight_covariance(self, j: int) -> FloatArray:
        """(p, p) of one error's linear weights: of the processes, weighted by their shares without zero."""
        share = self._share[j, 1:] / self._share[j, 1:].sum()
        each = [process.weight_covariance(j) for process in self._processes]
        return np.asarray(sum(part * one for part, one in zip(share, each, strict=True)))

    def state(self) -> MixtureState:
        """A copy."""
        r, n = self._rows, self._rows.n
        return MixtureState(
            x=r.x[:n].copy(),
            time=r.time[:n].copy(),
            weight=r.weight[:n].copy(),
            jolt=r.jolt[:n].copy(),
            y=r.y[:n].copy(),
            noise=r.noise[:n].copy(),
            relevance=np.stack([process.relevance for process in self._processes], axis=1),
            reference=self._reference.copy(),
            evidence=self._evidence.copy(),
            zero=self._zero.copy(),
            now=self._now,
            jolted=self._jolted.copy(),
            elapsed=self._elapsed.copy(),
            count=self._count.copy(),
            suspect=self._suspect.copy(),
            off=self._off.copy(),
            last=self._last.copy(),
            cursor=self._cursor,
            references=self._references,
            before=self._before.copy(),
            former_jolted=self._former_jolted.copy(),
            former_last=self._former_last.copy(),
            former_evidence=self._former_evidence.copy(),
            former_zero=self._former_zero.copy(),
            refused=self._refused.copy(),
        )

    def restore(self, state: MixtureState) -> None:
        """Continue from a state. ValueError: it has other inputs or experts."""
        expected = self._errors, len(self._processes), self._inputs
        if state.relevance.shape != expected or state.x.shape[1] != self._features:
            raise ValueError(f"relevance {state.relevance.shape}: expected {expected}")
        self._rows.put(state.x, state.time, state.weight, state.jolt, state.y, state.noise)
        self._reference, self._references = state.reference.copy(), state.references
        self._rows.reference[:] = 0.0 if self._references else state.reference
        self._evidence, self._zero = state.evidence.copy(), state.zero.copy()
        self._share = self._shares()
        self._now, self._jolted, self._elapsed = state.now, state.jolted.copy(), state.elapsed.copy()
        self._count, self._cursor = state.count.copy(), state.cursor
        self._suspect, self._off, self._last = state.suspect.copy(), state.off.copy(), state.last.copy()
        self._before, self._refused = state.before.copy(), state.refused.copy()
        self._former_jolted, self._former_last = state.former_jolted.copy(), state.former_last.copy()
        self._former_evidence, self._former_zero = state.former_evidence.copy(), state.former_zero.copy()
        for e, process in enumerate(self._processes):
            process.restore(state.relevance[:, e])
        self._weights = None

    def elapse(self, steps: int) -> None:
        """Let this many steps pass."""
        self._now += steps * self._per_step
        self._elapsed += steps * self._per_step

    def new_reference(self) -> None:
        """Errors are zero now, with features 0, but for the noise of the reference. Former rows count from the former
        reference: they still tell of the weights, and no longer of the level."""
        known, rows = self._count > 0, self._rows
        # The former reference's noise was part of each row; as a part of the level it tells nothing of the new one's.
        rows.jolt[: rows.n] += rows.reference
        self._jolted += rows.reference + np.where(known, OTHER_REFERENCE, 0.0)
        rows.reference[:], self._references = 0.0, self._references + 1
        x, nothing = np.zeros(self._features), np.zeros(self._errors)
        for process in self._processes:
            process.rebuild()
            process.look(x, self._now, self._jolted, reference=True)
        self._append(x, nothing, np.where(known, self._reference, np.inf))
        # Zero stays as likely as it was, but the reference's noise is another number from now on.
        self._zero = np.zeros_like(self._zero)
        self._zero[:, 3] = -2.0 * self._evidence[:, 0]
        self._last, self._elapsed = np.where(known, 0.0, np.nan), np.zeros(self._errors)
        self._suspect, self._off = np.zeros((2, self._errors))
        self._before[:], self._refused[:] = -1, np.nan
        self._weights = None

    def add_level_variance(self, variance: FloatArray) -> None:
        """(9,) variances by which the levels may have changed."""
        self._jolted += variance

    def predict(self, x: FloatArray, ahead: float = 0) -> tuple[FloatArray, FloatArray]:
        """(9,) means and variances with features x (p,), `ahead` steps from now. Before the first measurement of an
        error: 0 and 0."""
        return self._mixed(*self._each(x, ahead, reference=False))

    def expect(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(9,) means and variances of what a measurement now would show, its own noise aside."""
        return self._mixed(*self._each(x, 0, reference=True))

    def _each(self, x: FloatArray, ahead: float, *, reference: bool) -> tuple[FloatArray, FloatArray]:
        """(9, E + 1) means and variances of zero and of each process, their misfit included."""
        mean, variance = np.zeros((2, *self._share.shape))
        if reference:
            first = self._reference
            variance[:, 0] = first / (1.0 + first * self._zero[:, 0])
            mean[:, 0] = variance[:, 0] * self._zero[:, 1]
        now = self._now + ahead * self._per_step
        for e, process in enumerate(self._processes, start=1):
            mean[:, e], variance[:, e] = process.look(x, now, self._jolted, reference=reference)
        return mean, np.maximum(variance, 0.0) + self._misfit

    def _mixed(self, mean: FloatArray, variance: FloatArray) -> tuple[FloatArray, FloatArray]:
        known, centre = self._count > 0, np.sum(self._share * mean, axis=1)
        share = self._share[:, 1:] / self.believed[:, None]
        spread = np.sum(share * (variance + (mean - centre[:, None]) ** 2)[:, 1:], axis=1)
        return np.where(known, centre, 0.0), np.where(known, spread, 0.0)

    def covariance(self, x: FloatArray, others: FloatArray, ahead: FloatArray) -> FloatArray:
        """(9, S) between a measurement now with features x (p,), and the errors `ahead` (S,) steps from now with others
        (S, p)."""
        share, later = self._share[:, 1:] / self.believed[:, None], self._now + ahead * self._per_step
        each = [process.together(x, others, self._now, later, self._jolted) for process in self._processes]
        here = np.stack([mean for mean, _, _ in each], axis=1)
        apart = here - np.sum(share * here, axis=1)[:, None]
        parts = (share[:, e, None] * (apart[:, e, None] * there + within) for e, (_, there, within) in enumerate(each))
        shared = np.sum(np.stack(list(parts)), axis=0)
        return np.where((self._count > 0)[:, None], shared, 0.0)

    def contributions(self, x: FloatArray) -> FloatArray:
        """(9, p) by feature: what it adds to the estimate with features x (p,). The rest is the level."""
        each = np.stack([process.contributions(x) for process in self._processes], axis=1)
        return np.asarray(np.einsum("je,jep->jp", self._share[:, 1:], each))

    def level(self) -> tuple[FloatArray, FloatArray]:
        """(9,) mean and variance of the level."""
        mean, variance = np.zeros((2, *self._share.shape))
        for e, process in enumerate(self._processes, start=1):
            mean[:, e], variance[:, e] = process.level(self._now, self._jolted)
        return self._mixed(mean, np.maximum(variance, 0.0))

    def widen(self, factor: FloatArray) -> None:
        """(inputs,) features became this much smaller. A priori an input is in the new unit what it was in the old."""
        self._rows.rescale(np.repeat(1.0 / factor, self._features // max(self._inputs, 1)))
        for process in self._processes:
            process.rebuild()
        self._weights = None

    def learn(self, x: FloatArray, errors: FloatArray, sigma: FloatArray, doubt: FloatArray) -> Surprise:
        """Take in a measurement: (9,) errors, NaN where there is none, and their standard uncertainties.

        doubt: (9,) variance that missing inputs add to a prediction.
        """
        ratio = np.full(self._errors, np.nan)
        outlier = np.zeros(self._errors, dtype=np.bool_)
        noise = np.full(self._errors, np.inf)
        measured = np.flatnonzero(np.isfinite(errors))
        noise[measured] = np.maximum(sigma, _LEAST_NOISE)[measured] ** 2 + doubt[measured]
        for j in measured[self._count[measured] == 0]:
            self._begin(int(j), float(errors[j]), float(noise[j]))
        mean, variance = self._each(x, 0, reference=True)
        forgotten, faults = np.zeros(self._errors, dtype=np.int64), {}
        for j in measured:
            forgotten[j] = self._take_back(int(j), x, float(errors[j]), float(noise[j]), mean[j], variance[j])
        if (self._before[measured] >= 0).any() or forgotten.any():  # it has looked from fewer rows
            mean, variance = self._each(x, 0, reference=True)
        expected = self._mixed(mean, variance)
        for j in measured.tolist():
            fault = self._fault(j, float(errors[j]), float(noise[j]), mean[j], variance[j])
            if fault is not None:
                faults[j], noise[j] = fault, np.inf
        measured = np.array([j for j in measured.tolist() if j not in faults], dtype=np.int64)
        errors = np.where(np.isfinite(noise), errors, np.nan)
        for j in measured:
            ratio[j], outlier[j] = self._weigh(int(j), float(errors[j]), noise, mean[j], variance[j])
        self._share = self._shares()
        self._append(x, np.where(np.isfinite(errors), errors, 0.0), noise)
        self._count[measured] += 1
        self._elapsed[measured] = 0.0
        self._renew()
        self._weights = None
        return Surprise(ratio, outlier, faults, forgotten, variance=expected[1])

    def _append(self, x: FloatArray, y: FloatArray, noise: FloatArray) -> None:
        """One more row, at whose features (p,) the processes have just looked."""
        if self._rows.is_full():
            self._rows.thin()
            self._before[:] = -1
            for process in self._processes:
                process.rebuild()
                process.look(x, self._now, self._jolted, reference=True)
        row = x, self._now, self._jolted, y, noise
        for process in self._processes:
            process.append(*row)
        self._rows.append(*row)

    def _begin(self, j: int, y: float, noise: float) -> None:
        """Errors are deviations from the reference: the level starts at zero, unless the first measurement is so far
        off that the reference is not the present state."""
        self._reference[j] = _REFERENCE * noise
        if self._references:
            self._jolted[j] += self._reference[j]
        else:
            self._rows.reference[j] = self._reference[j]
        self._elapsed[j] = 0.0
        if abs(y) > _FIRST_FAR * np.sqrt(noise):
            self._jolted[j] += y * y

    def _weigh(self, j: int, y: float, noise: FloatArray, mean: FloatArray, variance: FloatArray) -> tuple[float, bool]:
        """The experts' evidence after a measurement y, which (E + 1,) mean and variance expected; enlarges the (9,)
        noise of an outlier, and the level's variance where the level moves fast."""
        own, share, reference = float(noise[j]), self._share[j], float(self._reference[j])
        innovation = y - mean
        centre = float(share @ innovation)
        total = float(share @ (variance + (innovation - centre) ** 2)) + own
        ratio = centre / np.sqrt(total)
        outlier = jump = False
        change = 2.0 * own + (_FASTEST * UNIT) ** 2 * self._elapsed[j]
        if abs(ratio) > _FAR:
            self._remember(j)
            sudden = (y - self._last[j]) ** 2 > _FAR**2 * change  # NaN compares false
            outlier = bool(sudden and self._suspect[j] * centre <= 0.0)
            jump = not outlier
        elif min(abs(ratio), abs(self._off[j])) > _TWICE_OFF and ratio * self._off[j] > 0.0:
            jump = True
        if not (jump or outlier) and self._jolted[j] == self._former_jolted[j]:
            self._before[j] = -1
        self._off[j], self._refused[j] = ratio, y if outlier else np.nan
        self._suspect[j] = centre if outlier else 0.0
        if not outlier:
            self._last[j] = y
        if jump:
            self._jolted[j] += centre**2
            variance = variance + np.append(0.0, np.full(len(variance) - 1, centre**2))
        elif outlier:
            noise[j] += (centre / _OUTLIER_AS) ** 2 - total
        spread = variance + noise[j]
        evidence = _KEPT * self._evidence[j] - 0.5 * (np.log(spread) + innovation**2 / spread)
        # Zero with the reference's noise, which is one number: its evidence must not forget how unlikely that is.
        self._zero[j] = _KEPT * self._zero[j] + np.array([1.0, y, y * y, 0.0]) / noise[j]
        self._zero[j, 3] += np.log(noise[j])
        one, first, second, log = self._zero[j]
        told = first**2 / (1.0 / reference + one)
        evidence[0] = -0.5 * (log + second - told + np.log1p(reference * one))
        self._evidence[j] = evidence
        return float(ratio), outlier

    def _fault(self, j: int, y: float, own: float, mean: FloatArray, variance: FloatArray) -> MeasurementFault | None:
        """What a measurement y is instead of one, if (E + 1,) means and variances expected another."""
        off = abs(_ratio(y, own, self._share[j], mean, variance))
        if off > _FAR and y == self._refused[j]:
            return MeasurementFault.STUCK
        for fault, times in _TIMES.items():
            scaled = abs(_ratio(y / times, own, self._share[j], mean, variance))
            # An error within its noise is zero in any unit.
            if off > _TWICE_OFF and scaled < min(off / 2.0, _FIRST_FAR) and abs(y / times) > _FIRST_FAR * np.sqrt(own):
                return fault
        return None

    def _remember(self, j: int) -> None:
        """What is known before a far measurement, unless it is one of a day that may still be taken back."""
        first = int(self._before[j])
        if first < 0 or not self._is_of_a_day(first):
            self._before[j] = self._rows.n
            self._former_jolted[j], self._former_last[j] = self._jolted[j], self._last[j]
            self._former_evidence[j], self._former_zero[j] = self._evidence[j], self._zero[j]

    def _is_of_a_day(self, first: int) -> bool:
        n = self._rows.n
        return n - first <= NEWEST and (
            first == n or (self._now - self._rows.time[first]) * _DRIFT_STEP_S <= _TAKEN_BACK_S
        )

    def _take_back(self, j: int, x: FloatArray, y: float, own: float, mean: FloatArray, variance: FloatArray) -> int:
        """Forget the measurements of a bad day, if y is far from the (E + 1,) present means and near to what was
        predicted from the rows before that day. Returns how many."""
        first = int(self._before[j])
        if first < 0 or first >= self._rows.n or not self._is_of_a_day(first):
            return 0
        if abs(_ratio(y, own, self._share[j], mean, variance)) <= _FAR:
            return 0
        jolted = self._jolted.copy()
        jolted[j] = self._former_jolted[j]
        then, spread = mean.copy(), variance.copy()
        for e, process in enumerate(self._processes, start=1):
            found = process.look(x, self._now, jolted, reference=True, rows_used=first)
            then[e], spread[e] = found[0][j], found[1][j] + self._misfit[e]
        share = self._shares(self._former_evidence)[j]
        if abs(_ratio(y, own, share, then, spread)) > _RIGHT:
            return 0
        many = int(self._rows.known[j, first : self._rows.n].sum())
        self._rows.forget(j, first, float(jolted[j]))
        for process in self._processes:
            process.rebuild(j)
        self._jolted, self._last[j], self._before[j] = jolted, self._former_last[j], -1
        self._evidence[j], self._zero[j] = self._former_evidence[j], self._former_zero[j]
        self._share[j], self._suspect[j], self._off[j], self._refused[j] = share, 0.0, 0.0, np.nan
        return many

    def _shares(self, evidence: FloatArray | None = None) -> FloatArray:
        """(9, E + 1) weights of the experts, by their evidence; None: the present one."""
        with np.errstate(divide="ignore"):
            likely = np.log(self._first) + _TEMPER * (self._evidence if evidence is None else evidence)
        share = np.exp(likely - likely.max(axis=1, keepdims=True))
        return np.asarray((1.0 - _SHARED) * share / share.sum(axis=1, keepdims=True) + _SHARED * self._first)

    def _renew(self) -> None:
        many = min(self._errors, max(int(_RENEWAL_COST / max(self._rows.n, 1) ** 3), 1))
        for j in (self._cursor + np.arange(many)) % self._errors:
            if self._count[j] >= _EVIDENCE_FROM:
                for process in self._processes:
                    process.renew(int(j))
        self._cursor = (self._cursor + many) % self._errors


def _ratio(y: float, own: float, share: FloatArray, mean: FloatArray, variance: FloatArray) -> float:
    """Innovation over its standard deviation, of a measurement y with its own variance; (E + 1,) of the experts."""
    innovation = y - mean
    centre = float(share @ innovation)
    return centre / float(np.sqrt(float(share @ (variance + (innovation - centre) ** 2)) + own))
