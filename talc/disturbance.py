"""The disturbance of a model: probing noise, and a slow part of unknown pole and drift that measurements follow.

A day of training cannot distinguish a slow drift from none, and other days drift differently. So instead of one answer
a grid of candidates is kept, each an AR(1) disturbance, weighted by likelihood and re-weighted by each later
measurement
(multiple-model estimation, Magill, IEEE Trans. Automatic Control 10 (1965) 434-439; the filters run in the kernel).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from talc.frame import FloatArray, IntArray

_POLES: Final = (0.9, 0.97, 0.99, 0.997, 0.9995)
"""Of one step, whatever it lasts, as the models' own. At 5 min, time constants of 47 min to 7 days."""
_RATIOS: Final = tuple(np.geomspace(1e-4, 30.0, 12).tolist())
"""Drift variance per step over noise variance."""
_TEMPER: Final = 0.05
"""Fraction of training's log-likelihood with which later measurements start: one day's evidence is not final."""
_LEAST_ROWS: Final = 24


def _empty() -> FloatArray:
    return np.zeros(0)


@dataclass(frozen=True, eq=False)
class Disturbance:
    """Candidates d[k] = pole d[k-1] + drift w[k], observed in white noise. None: the model has no such part."""

    noise_std: float = 0.0
    """Standard deviation of one measurement; µm or µm/m. 0: a measurement is fully believed."""
    poles: FloatArray = field(default_factory=_empty)
    """(m,) per grid step."""
    drifts: FloatArray = field(default_factory=_empty)
    """(m,) standard deviation of w; µm or µm/m."""
    log_weights: FloatArray = field(default_factory=_empty)
    """(m,) relative log-probability at the end of training."""

    def __post_init__(self) -> None:
        for name in ("poles", "drifts", "log_weights"):
            array = np.array(getattr(self, name), dtype=np.float64)
            array.setflags(write=False)
            object.__setattr__(self, name, array)
            if array.shape != self.poles.shape or array.ndim != 1 or not np.isfinite(array).all():
                raise ValueError(f"{name} has shape {array.shape}: expected {self.poles.shape}, finite")
        if not (np.isfinite(self.noise_std) and self.noise_std >= 0.0):
            raise ValueError(f"noise_std = {self.noise_std}: expected 0 or more")

    def to_dict(self) -> dict[str, Any]:
        """JSON-able; floats come back bit for bit."""
        lists = {name: getattr(self, name).tolist() for name in ("poles", "drifts", "log_weights")}
        return {"noise_std": self.noise_std, **lists}

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any]) -> "Disturbance":
        """The inverse of `to_dict`. ValueError: not its fields."""
        if set(plain) != {"noise_std", "poles", "drifts", "log_weights"}:
            raise ValueError(f"a disturbance's fields are not {sorted(plain)}")
        return cls(**plain)


def disturbance_of(residual: FloatArray, steps: IntArray) -> Disturbance:
    """Likelihood of each candidate by a scalar Kalman filter, its noise variance concentrated out.

    residual: (n,) what the inputs did not explain, µm or µm/m, preferably on rows that the fit has not seen; steps:
    (n,) their grid steps, ascending. With fewer than 24 rows nothing can be estimated, and each measurement is fully
    believed.
    """
    pole, ratio = (axis.ravel() for axis in np.meshgrid(_POLES, _RATIOS, indexing="ij"))
    n = residual.size
    if n < _LEAST_ROWS:
        spread = max(float(residual.std()), 1e-6) if n else 1.0
        return Disturbance(0.0, pole, np.sqrt(ratio) * spread, np.zeros(pole.size))
    settled = ratio / (1.0 - pole**2)
    offset, variance = np.zeros(pole.size), settled.copy()
    squares, logs = np.zeros(pole.size), np.zeros(pole.size)
    for e, h in zip(residual.tolist(), np.diff(steps, prepend=steps[0]).tolist(), strict=True):
        if h:
            kept = pole**h
            offset, variance = kept * offset, settled + kept**2 * (variance - settled)
        innovation, spread = e - offset, variance + 1.0
        squares += innovation**2 / spread
        logs += np.log(spread)
        gain = variance / spread
        offset, variance = offset + gain * innovation, variance - gain * variance
    noise = np.maximum(squares / n, 1e-12)
    likelihood = -0.5 * (n * np.log(noise) + logs)
    likelihood -= likelihood.max()
    weight = np.exp(likelihood)
    common = float(weight @ noise / weight.sum())
    return Disturbance(float(np.sqrt(common)), pole, np.sqrt(ratio * common), _TEMPER * likelihood)
