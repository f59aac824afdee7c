"""The learner: from rows of inputs and measurements to estimates of the nine errors, with uncertainty and reasons."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from talc.explanation import Explanation, Weights
from talc.frame import BoolArray, FloatArray, IntArray
from talc.learner.features import LagBank
from talc.learner.inputs import InputMemory
from talc.learner.mixture import Mixture
from talc.learner.plausible import SHORT_GAP, InputCheck, Suspicion
from talc.learner.process import OtherMachines
from talc.learner.told import MixtureState, Surprise

TIME_CONSTANTS_S = (0.0, 900.0, 2700.0, 8100.0, 24300.0)
"""0, 15 min, 45 min, 2.25 h, 6.75 h: any smooth response of a machine is near a sum of these."""
SPAN = 3.0
"""Span of an input: 3 K for a temperature. Inputs that move further are rescaled (`LagBank.widen`)."""
_SHORT_GAP_S = 3600.0
"""Across a shorter gap inputs are interpolated linearly; after a longer one the lags restart at the present values."""
_LONGEST_RAMP = 2016
"""Steps, whatever they last, because each is computed; the lags restart after a longer gap."""
_TRUSTED = 0.1
"""An error is corrected unless it is zero with a probability of 90 %; its estimate is shrunk by this probability."""
_SIGMA_RATE = 0.5
"""How fast sigma is scaled by how far measurements are off. A measurement counts as far as its own noise does not hide
this. A slower rate, or a lower bound, would suit the simulated machines, whose intervals are too wide; on a real
machine measured rarely after a dense beginning they become too narrow."""
_SIGMA_WANTED = 0.8
"""Mean |z| of a normal distribution."""
_SIGMA_BOUNDS = (0.8, 3.0)
_FARTHEST_Z = 4.0


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """Estimates of the nine errors, µm and µm/m."""

    value: FloatArray
    """(9,) the correction: 0 where nothing better is known, NaN before the first measurement of an error."""
    sigma: FloatArray
    """(9,) its standard uncertainty."""
    trusted: BoolArray
    """(9,) whether the estimate is better than no correction."""


@dataclass(frozen=True, slots=True, eq=False)
class LearnerState:
    """Everything that a learner knows."""

    mixture: MixtureState
    level: FloatArray
    origin: FloatArray
    span: FloatArray
    wide: BoolArray
    reference: FloatArray
    known: BoolArray
    last: FloatArray
    away: FloatArray
    mean: FloatArray
    covariance: FloatArray
    rows: int
    anchored: bool
    scale: float
    doubt: FloatArray
    habit: FloatArray
    fault: IntArray


class RowLearner:
    """Inputs, lags and the mixture together; a pure function of the rows it has seen.

    Parameters
    ----------
    inputs: number of inputs
    step_s: grid step
    noise: (9,) standard uncertainty of a measurement that is reported without one; its length, elsewhere nine, is the
        number of errors
    others: what other machines have learnt, in the spans (n,) beside it; NaN: not known
    """

    def __init__(
        self, inputs: int, step_s: float, noise: FloatArray, others: tuple[FloatArray, OtherMachines] | None = None
    ) -> None:
        self._memory = InputMemory(inputs, step_s)
        self._bank = LagBank(inputs, TIME_CONSTANTS_S, step_s, SPAN)
        if others is not None:
            self._bank.span = np.where(np.isfinite(others[0]), others[0], SPAN)
            self._bank.wide = self._bank.span > SPAN
        self._errors = len(noise)
        self._mixture = Mixture(
            inputs, self._bank.lags, step_s, others=None if others is None else others[1], errors=self._errors
        )
        self._check = InputCheck(inputs, step_s)
        self.suspicions: list[Suspicion] = []
        """Faults of inputs that the latest row began."""
        self._short_gap = round(_SHORT_GAP_S / step_s)
        self._noise = noise
        self._anchored = False
        self._scale = 1.0
        self._doubt = np.zeros(self._errors)
        """(9,) variance that missing inputs add at present."""

    @property
    def doubted(self) -> BoolArray:
        """(n,) inputs whose values are none at present: they are estimated from the others, or mended."""
        return self._check.doubted

    @property
    def scale(self) -> float:
        """Factor on the experts' standard deviations, because measurements were further off than these said."""
        return self._scale

    def advance(self, values: FloatArray, valid: BoolArray, gap: int) -> BoolArray:
        """The next row, after `gap` steps without one. Returns (n,) the inputs that returned as other sensors."""
        memory, bank, mixture, check = self._memory, self._bank, self._mixture, self._check
        before = memory.last - memory.reference
        self.suspicions = check.judge(values, valid, memory, gap=gap > SHORT_GAP)
        filled, missing, moved = memory.fill(check.mended(values), valid & ~check.lost, check.same)
        before = np.where(moved, before + memory.last - filled, before)
        deviation = filled - memory.reference
        if not self._anchored:
            bank.restart(np.zeros_like(deviation))
        else:
            factor = bank.widen(deviation)
            if (factor > 1.0).any():
                mixture.widen(factor)
            if gap:
                self._cross(before, deviation, gap)
            else:
                bank.advance(deviation)
        if self._anchored:  # at the reference the level is zero
            mixture.elapse(gap + 1)
        self._doubt = np.zeros(self._errors)
        if missing is not None:
            gains = mixture.weights().reshape(self._errors, len(values), -1).sum(axis=2) / bank.span
            self._doubt = np.maximum(np.einsum("ji,ik,jk->j", gains, missing, gains), 0.0)
        return moved

    def new_reference(self) -> None:
        """Errors count from the present row, in which they are zero: of what was learnt only the level ends."""
        if self._anchored:
            self._bank.count_from_here()
            self._mixture.new_reference()

    def estimate(self, ahead: int = 0) -> Estimate:
        """The estimates of the present row, or of this many steps ahead if the inputs stay as they are."""
        return self._estimate(self._bank.ahead(ahead) if ahead else self._bank.features(), ahead)

    def between(self, values: FloatArray, valid: BoolArray, steps: float) -> FloatArray:
        """(9,) the correction at a moment between two rows: this many steps after the last one, > 0.

        Changes nothing. Inputs stay as they were in the last row, if they are not valid now, were not valid then (they
        may be other sensors now), or move further than ever before: `advance` decides what to make of these.
        """
        memory, bank, mixture = self._memory, self._bank, self._mixture
        before = memory.last - memory.reference
        now = np.where(valid & (memory.away == 0), values - memory.reference, before)
        mean, _ = mixture.predict(bank.towards(steps, np.where(bank.beyond(now), before, now)), steps)
        return np.where(mixture.count > 0, np.where(mixture.believed > _TRUSTED, mean, 0.0), np.nan)

    def forecast(self, ahead: Sequence[int]) -> tuple[list[Estimate], FloatArray, list[Estimate]]:
        """The estimates at S later steps if the inputs stay as they are; (S, 9) their sigma if the machine is measured
        now; and the estimates if the inputs have their mean of the last two weeks from now on."""
        bank, mixture = self._bank, self._mixture
        x, later = bank.features(), np.stack([bank.ahead(steps) for steps in ahead])
        stays = [self._estimate(features, steps) for features, steps in zip(later, ahead, strict=True)]
        usual = self._memory.mean - self._memory.reference
        moved = [self._estimate(bank.towards(steps, usual), steps) for steps in ahead]
        _, now = mixture.expect(x)
        shared = self._scale**2 * mixture.covariance(x, later, np.asarray(ahead, dtype=np.float64))
        gained = shared**2 / (self._scale**2 * now + self._doubt + self._noise**2)[:, None]
        left = np.stack([e.sigma for e in stays]) ** 2 - gained.T
        return stays, np.sqrt(np.maximum(left, 0.0)), moved

    def along(self, changes: FloatArray, ahead: Sequence[int]) -> list[Estimate]:
        """The estimates at S later steps, if the inputs differ from now by (T, n) at each of the next T steps."""
        deviations = self._memory.last - self._memory.reference + changes
        later = self._bank.along(deviations, ahead)
        return [self._estimate(features, steps) for features, steps in zip(later, ahead, strict=True)]

    def _estimate(self, x: FloatArray, ahead: int) -> Estimate:
        """With features x (n,), `ahead` steps ahead."""
        mean, variance = self._mixture.predict(x, ahead)
        variance = self._scale**2 * variance + self._doubt
        trusted = self._mixture.believed > _TRUSTED
        # That an error cannot be shown does not make it zero: its uncertainty is still the mixture's.
        value = np.where(trusted, mean, 0.0)
        square = variance + (mean - value) ** 2
        none = self._mixture.count == 0
        return Estimate(np.where(none, np.nan, value), np.where(none, np.nan, np.sqrt(square)), trusted & ~none)

    def learn(self, errors: FloatArray, sigma: FloatArray) -> Surprise:
        """A measurement of the present row: (9,) errors, NaN where not measured, and their standard uncertainties."""
        if not self._anchored:
            self._memory.anchor()
            self._bank.restart(np.zeros(len(self._memory.last)))
            self._anchored = True
        noise = np.where(np.isfinite(sigma) & (sigma > 0.0), sigma, self._noise)
        x = self._bank.features()
        surprise = self._mixture.learn(x, errors, noise, self._doubt)
        # Probing noise is known; only the experts' own part may be over- or underconfident.
        settled = np.isfinite(surprise.ratio) & ~surprise.outlier & (self._mixture.count > 1)
        if settled.any():
            known = noise[settled] ** 2
            part = surprise.variance[settled] + self._doubt[settled]
            scaled = self._scale**2 * part
            z = np.abs(surprise.ratio[settled]) * np.sqrt((part + known) / (scaled + known))
            tells = scaled / (scaled + known)
            off = float(np.mean(tells * (np.minimum(z, _FARTHEST_Z) - _SIGMA_WANTED)))
            low, high = _SIGMA_BOUNDS
            self._scale = min(max(self._scale * float(np.exp(_SIGMA_RATE * off)), low), high)
        return surprise

    def explain(self) -> Explanation:
        """The reasons for the estimates of the present row."""
        mixture, x = self._mixture, self._bank.features()
        value = self._estimate(x, 0).value
        shown = np.nan_to_num(value) != 0.0
        parts = np.where(shown[:, None], mixture.contributions(x), 0.0)
        inputs = parts.reshape(self._errors, -1, self._bank.lags).sum(axis=2)
        return Explanation(inputs, np.nan_to_num(value) - inputs.sum(axis=1), mixture.share.copy(), mixture.believed)

    def weights(self) -> Weights:
        """What is known of how the errors follow the inputs."""
        mixture, bank = self._mixture, self._bank
        shape, span = (self._errors, -1, bank.lags), bank.span[:, None]
        x, (level, level_variance) = bank.features(), mixture.level()
        return Weights(
            inputs=mixture.weights().reshape(shape) / span,
            inputs_sigma=self._scale * np.sqrt(mixture.variances()).reshape(shape) / span,
            level=level - mixture.weights() @ bank.origin.ravel(),
            level_sigma=self._scale * np.sqrt(level_variance),
            smooth=mixture.predict(x)[0] - level - mixture.weights() @ x,
            share=np.where(mixture.believed > _TRUSTED, 1.0, 0.0),
            reference=self._memory.reference.copy(),
            time_constants_s=TIME_CONSTANTS_S,
        )

    def state(self) -> LearnerState:
        """A copy of everything that is known."""
        m = self._memory
        return LearnerState(
            mixture=self._mixture.state(),
            level=self._bank.level.copy(),
            origin=self._bank.origin.copy(),
            span=self._bank.span.copy(),
            wide=self._bank.wide.copy(),
            reference=m.reference.copy(),
            known=m.known.copy(),
            last=m.last.copy(),
            away=m.away.astype(np.float64),
            mean=m.mean.copy(),
            covariance=m.covariance.copy(),
            rows=m.rows,
            anchored=self._anchored,
            scale=self._scale,
            doubt=self._doubt.copy(),
            habit=self._check.habit.copy(),
            fault=self._check.fault.copy(),
        )

    def restore(self, state: LearnerState) -> None:
        """Continue from a state. ValueError: it has other inputs."""
        self._mixture.restore(state.mixture)
        self._bank.level, self._bank.span = state.level.copy(), state.span.copy()
        self._bank.wide, self._bank.origin = state.wide.copy(), state.origin.copy()
        m = self._memory
        m.reference, m.known, m.last = state.reference.copy(), state.known.copy(), state.last.copy()
        m.away, m.mean, m.covariance = state.away.astype(np.int64), state.mean.copy(), state.covariance.copy()
        m.rows, self._anchored, self._scale, self._doubt = state.rows, state.anchored, state.scale, state.doubt.copy()
        self._check.habit, self._check.fault = state.habit.copy(), state.fault.copy()

    def _cross(self, before: FloatArray, now: FloatArray, gap: int) -> None:
        """Cross a gap, in which the inputs are unknown. Its effect is judged by the difference of two guesses."""
        bank, mixture = self._bank, self._mixture
        if gap > _LONGEST_RAMP:
            bank.restart(now)
            return
        bank.ramp(before, now, gap + 1)
        if gap <= self._short_gap:
            return
        straight, _ = mixture.predict(bank.features())
        bank.restart(now)
        mixture.add_level_variance((mixture.predict(bank.features())[0] - straight) ** 2)
