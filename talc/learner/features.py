"""Inputs through a bank of stable first-order lags: the features of the learner."""

from collections.abc import Sequence

import numpy as np

from talc.frame import BoolArray, FloatArray

_ORDINARY = 60.0
"""A temperature in degC stays within this of its reference. An input that does not is a machine state or a length, in
whatever unit: its span is the largest deviation so far, in powers of two. So an input that moves for the first time
after weeks cannot upset the prediction."""
_JUMP = 15.0
"""A temperature in degC moves less than this in one step; an input that does not is no temperature either."""


class LagBank:
    """Deviations of (n,) inputs from their reference, over their spans, through (L,) lags each.

    Nothing in it is estimated, so nothing can become unstable. Before the first step the inputs were constant.

    Parameters
    ----------
    inputs: n
    time_constants_s: of the lags; 0: no lag
    step_s: grid step
    span: first span of every input, in its unit (K for temperatures)
    """

    def __init__(self, inputs: int, time_constants_s: tuple[float, ...], step_s: float, span: float) -> None:
        constants = np.asarray(time_constants_s)
        self.lags = len(time_constants_s)
        self._kept = np.where(constants > 0, np.exp(-step_s / np.where(constants > 0, constants, 1.0)), 0.0)
        self.span = np.full(inputs, span)
        self.wide = np.zeros(inputs, dtype=np.bool_)
        """(n,) whether an input is not a temperature: its span grows."""
        self.level = np.zeros((inputs, self.lags))
        """(n, L) outputs of the lags, in spans; the first one has no lag."""
        self.origin = np.zeros((inputs, self.lags))
        """(n, L) those at the latest reference, from which features count."""

    def features(self) -> FloatArray:
        """(n L,) input by input."""
        return np.asarray(self.level - self.origin).ravel()

    def ahead(self, steps: int) -> FloatArray:
        """The features this many steps ahead, if the inputs stay as they are."""
        return self.towards(steps, self.level[:, 0] * self.span)

    def towards(self, steps: float, deviation: FloatArray) -> FloatArray:
        """The features this many steps ahead, > 0, if the inputs have these (n,) deviations from now on."""
        kept = self._kept**steps
        later = kept * self.level + (1.0 - kept) * (deviation / self.span)[:, None]
        return np.asarray(later - self.origin).ravel()

    def along(self, deviations: FloatArray, steps: Sequence[int]) -> FloatArray:
        """(S, n L) the features these many steps ahead, if the inputs have these deviations (T, n) meanwhile."""
        level, found = self.level, dict[int, FloatArray]()
        for step, deviation in enumerate(deviations, start=1):
            level = self._kept * level + (1.0 - self._kept) * (deviation / self.span)[:, None]
            if step in steps:
                found[step] = np.asarray(level - self.origin).ravel()
        return np.stack([found[step] for step in steps])

    def widen(self, deviation: FloatArray) -> FloatArray:
        """Let spans grow where these (n,) deviations require it. Returns the (n,) factors by which they grew."""
        size = np.abs(deviation)
        self.wide |= self._is_wide(deviation)
        factor = np.ones(len(self.span))
        beyond = self.beyond(deviation)
        if beyond.any():
            factor[beyond] = np.exp2(np.ceil(np.log2(size[beyond] / self.span[beyond])))
            self.span = self.span * factor
            self.level, self.origin = self.level / factor[:, None], self.origin / factor[:, None]
        return factor

    def beyond(self, deviation: FloatArray) -> BoolArray:
        """(n,) whether `widen` would let the span of an input grow with these (n,) deviations."""
        wide = self.wide | self._is_wide(deviation)
        return np.asarray(wide & (np.abs(deviation) > self.span), dtype=np.bool_)

    def _is_wide(self, deviation: FloatArray) -> BoolArray:
        jump = np.abs(deviation - self.level[:, 0] * self.span)
        return np.asarray((np.abs(deviation) > _ORDINARY) | (jump > _JUMP), dtype=np.bool_)

    def advance(self, deviation: FloatArray) -> None:
        """Advance one step; (n,) deviations in physical units."""
        now = (deviation / self.span)[:, None]
        self.level = self._kept * self.level + (1.0 - self._kept) * now

    def ramp(self, before: FloatArray, now: FloatArray, steps: int) -> None:
        """Advance this many steps, along a straight line from the last deviations to these."""
        for i in range(1, steps + 1):
            self.advance(before + (now - before) * (i / steps))

    def count_from_here(self) -> None:
        """The present features become 0."""
        self.origin = self.level.copy()

    def restart(self, deviation: FloatArray) -> None:
        """As if the inputs had had these values for a long time."""
        self.level = np.repeat((deviation / self.span)[:, None], self.lags, axis=1)
