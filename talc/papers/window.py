"""Data that selectors and estimators share: one error's training rows in scaled units, a structure, its parameters."""

from dataclasses import dataclass

import numpy as np

from talc.frame import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """Consecutive grid steps of one thermal error's training, z-scored (Z22 eq. 1)."""

    u: FloatArray
    """(T, n) offered inputs, finite."""
    y: FloatArray
    """(T,) measured output; NaN where nothing was measured (weight 0 in Z22 eq. 5)."""
    past: FloatArray
    """(T,) output as one-step regressors see it: measured, or the model's own estimate at that time; NaN: neither."""
    y_std: float
    """µm or µm/m per scaled unit."""

    def __post_init__(self) -> None:
        if self.u.ndim != 2 or not np.isfinite(self.u).all():
            raise ValueError(f"u has shape {self.u.shape}: expected (T, n), all finite")
        for name in ("y", "past"):
            if getattr(self, name).shape != (len(self.u),):
                raise ValueError(
                    f"{name} has shape {getattr(self, name).shape}: expected ({len(self.u)},), as u has rows"
                )
        if not (np.isfinite(self.y_std) and self.y_std > 0):
            raise ValueError(f"y_std = {self.y_std}: expected more than 0")


@dataclass(frozen=True, slots=True)
class Structure:
    """Orders and inputs of one model (Z22 eq. 2). na = 0: FIR; na = 0 and every nb = 0: static."""

    na: int
    """Autoregressive order; poles of an output-error model."""
    inputs: tuple[int, ...]
    """Positions among the offered inputs, ascending."""
    nb: tuple[int, ...]
    """Order per input: nb + 1 coefficients."""

    def __post_init__(self) -> None:
        if self.na < 0 or len(self.nb) != len(self.inputs) or any(order < 0 for order in self.nb):
            raise ValueError(
                f"na = {self.na}, nb = {self.nb}: expected 0 or more, and one nb per input of {self.inputs}"
            )
        if list(self.inputs) != sorted(set(self.inputs)):
            raise ValueError(f"inputs = {self.inputs}: expected ascending positions")


@dataclass(frozen=True, slots=True, eq=False)
class Coefficients:
    """Coefficients in scaled units: y[k] = intercept - sum a_i y[k-i] + sum_s sum_j b_sj u_s[k-j]."""

    a: FloatArray
    """(na,)"""
    b: tuple[FloatArray, ...]
    """(nb_s + 1,) per input."""
    intercept: float
