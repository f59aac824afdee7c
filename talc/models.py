"""One thermal error's model, and the nine together: values that predict (Z22 eq. 1 and 2).

In scaled units (z-scores of the training window, eq. 1) a model is

    y[k] = intercept - sum_{i=1..na} a_i y[k-i] + sum_s sum_{j=0..nb_s} b_sj u_s[k-j]

Static and FIR models are the case na = 0. Outputs that were not measured are the model's own predictions (free run).
"""

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from talc import _kernel
from talc.frame import FloatArray
from talc.names import THERMAL_ERRORS

_MARGIN: Final = 1.0
"""How far beyond the training range inputs and predictions may go, as a share of that range."""
_GAIN_AGES: Final = 288
"""State-update gains are tabulated up to this age, in steps; older ones use the last."""


@dataclass(frozen=True, slots=True)
class Prediction:
    """One predicted thermal error."""

    value: float
    """µm, or µm/m for orientation errors."""
    bounded: bool
    """An input or the output was outside the model's bounds and was held at them."""


@dataclass(frozen=True, slots=True)
class Disturbance:
    """What the inputs do not explain: a slow AR(1) disturbance beside the white noise of probing.

    Decides how far a measurement moves the state, and how the uncertainty grows until the next one.
    """

    pole: float = 1.0
    """Of the disturbance, per grid step; 1: random walk."""
    drift_std: float = 0.0
    """Standard deviation of the disturbance's change in one step; µm or µm/m. 0: a measurement is taken whole."""
    noise_std: float = 0.0
    """Standard deviation of one measurement; µm or µm/m. 0: a measurement is taken whole."""

    def variance(self, age: int) -> float:
        """Variance of the unexplained part `age` steps after a measurement, before the next one."""
        start = self.noise_std**2
        retained = self.pole ** (2 * age)
        gathered = age if self.pole == 1.0 else (1.0 - retained) / (1.0 - self.pole**2)
        return start * retained + self.drift_std**2 * gathered

    def gain(self, age: int) -> float:
        """Share of a residual that a state update adopts, `age` steps after the last measurement (1: all of it)."""
        if self.drift_std == 0.0 or self.noise_std == 0.0:
            return 1.0
        variance = self.drift_std**2 * age + self._settled_variance(age) * self.pole ** (2 * age)
        return variance / (variance + self.noise_std**2)

    def _settled_variance(self, age: int) -> float:
        """Variance right after an update when one comes every `age` steps: P = M r / (M + r), M = rho² P + q."""
        q, r, rho2 = self.drift_std**2 * age, self.noise_std**2, self.pole ** (2 * age)
        p = q + r * (1.0 - rho2)
        return (math.sqrt(p * p + 4.0 * rho2 * q * r) - p) / (2.0 * rho2) if rho2 > 0.0 else r


def _frozen_array(values: object) -> FloatArray:
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


@dataclass(frozen=True, kw_only=True, eq=False)
class ErrorModel:
    """The model of one thermal error. Arrays are copied and read-only. ValueError names a field that cannot be.

    Bounds: every input is held inside `[u_low, u_high]` and every prediction inside `[y_low, y_high]`, which reach
    one training range beyond what training saw on either side; a prediction for which this mattered is flagged.
    """

    error: str
    """One of THERMAL_ERRORS."""
    inputs: tuple[str, ...]
    """Names of the inputs the model needs."""
    a: FloatArray
    """(na,) autoregressive coefficients."""
    b: tuple[FloatArray, ...]
    """One (nb_s + 1,) array of coefficients per input, in scaled units."""
    intercept: float = 0.0
    """In scaled units."""
    u_mean: FloatArray
    u_std: FloatArray
    """(n,) scaling of the inputs."""
    y_mean: float
    y_std: float
    """Scaling of the output; µm or µm/m."""
    u_low: FloatArray
    u_high: FloatArray
    """(n,) bounds of the inputs, physical units."""
    y_low: float
    y_high: float
    """Bounds of the prediction, µm or µm/m."""
    limit: float
    """Largest |free-run residual| over the measured training rows: the adaptive control limit."""
    residual_std: float
    """Root mean square of those residuals."""
    criterion: float
    """What the selection minimised."""
    disturbance: Disturbance = Disturbance()

    def __post_init__(self) -> None:
        for name in ("a", "u_mean", "u_std", "u_low", "u_high"):
            object.__setattr__(self, name, _frozen_array(getattr(self, name)))
        object.__setattr__(self, "inputs", tuple(self.inputs))
        object.__setattr__(self, "b", tuple(_frozen_array(b) for b in self.b))
        n = len(self.inputs)
        if self.error not in THERMAL_ERRORS:
            raise ValueError(f"error = {self.error!r}: expected one of {', '.join(THERMAL_ERRORS)}")
        if self.a.ndim != 1:
            raise ValueError(f"a has shape {self.a.shape}: expected (na,)")
        if len(self.b) != n or any(b.ndim != 1 or b.size == 0 for b in self.b):
            raise ValueError(f"b has shapes {[b.shape for b in self.b]}: expected {n} of (nb + 1,), one per input")
        for name in ("u_mean", "u_std", "u_low", "u_high"):
            if getattr(self, name).shape != (n,):
                raise ValueError(f"{name} has shape {getattr(self, name).shape}: expected ({n},), one per input")
        numbers = [self.a, *self.b, self.u_mean, self.u_std, self.u_low, self.u_high]
        numbers.append(np.array([self.intercept, self.y_mean, self.y_std, self.y_low, self.y_high, self.limit]))
        if not all(np.isfinite(x).all() for x in numbers):
            raise ValueError(f"the model of {self.error} holds a number that is not finite")
        if not (self.y_std > 0 and (self.u_std > 0).all()):
            raise ValueError(f"y_std = {self.y_std}, u_std = {self.u_std}: expected more than 0")

    @property
    def na(self) -> int:
        """Autoregressive order: the outputs of history `predict` needs."""
        return int(self.a.size)

    @cached_property
    def lags(self) -> int:
        """Rows of inputs `predict` needs, this step's included."""
        return max((b.size for b in self.b), default=1)

    @cached_property
    def gains(self) -> FloatArray:
        """Share of the residual a state update adopts, by age - 1 in steps."""
        return _frozen_array([self.disturbance.gain(age) for age in range(1, _GAIN_AGES + 1)])

    def poles(self) -> NDArray[np.complex128]:
        """(na,) roots of z^na + a_1 z^(na-1) + ... ."""
        return np.roots(np.concatenate([[1.0], self.a])).astype(np.complex128)

    def static_gain(self) -> FloatArray:
        """(n,) response to a lasting unit step of each input; µm or µm/m per unit of the input."""
        sums = np.array([b.sum() for b in self.b])
        return np.asarray(sums / (1.0 + self.a.sum()) * self.y_std / self.u_std, dtype=np.float64)

    def sigma(self, age: int) -> float:
        """Standard deviation of a prediction `age` steps after the last measurement; µm or µm/m.

        Never below the residuals of training when no disturbance was identified.
        """
        if self.disturbance.drift_std == 0.0:
            return self.residual_std
        return math.sqrt(self.disturbance.variance(age))

    def step(self, y_past: FloatArray, u_past: FloatArray) -> Prediction:
        """Predict this step's error.

        y_past: (na,) earlier outputs, most recent first; u_past: (lags, n) inputs, this step's first; physical units.
        ValueError: a wrong shape, or a value that is not finite (replace missing inputs before asking).
        """
        y_past, u_past = np.asarray(y_past, dtype=np.float64), np.asarray(u_past, dtype=np.float64)
        if y_past.shape != self.a.shape:
            raise ValueError(f"y_past has shape {y_past.shape}: expected {self.a.shape}")
        if u_past.shape != (self.lags, len(self.inputs)):
            raise ValueError(f"u_past has shape {u_past.shape}: expected {(self.lags, len(self.inputs))}")
        if not (np.isfinite(y_past).all() and np.isfinite(u_past).all()):
            raise ValueError(f"y_past or u_past of the model of {self.error} holds a value that is not finite")
        held = np.clip(u_past, self.u_low, self.u_high)
        u = (held - self.u_mean) / self.u_std
        value = self.intercept - float(self.a @ ((y_past - self.y_mean) / self.y_std))
        for s, b in enumerate(self.b):
            value += float(b @ u[: b.size, s])
        value = value * self.y_std + self.y_mean
        bounded = min(max(value, self.y_low), self.y_high)
        return Prediction(bounded, bool(bounded != value or (held != u_past).any()))

    def predict(self, y_past: FloatArray, u_past: FloatArray) -> float:
        """The value of `step`."""
        return self.step(y_past, u_past).value

    def state_update(self, y_past: FloatArray, measured: float, age: int = 1) -> FloatArray:
        """(na,) history after a measurement of this step, `age` steps after the last one.

        y_past[0] is this step's prediction. The whole history is shifted by a share of the residual: replacing only
        its newest value would feign a jump, which a model with two slow poles answers with a large overshoot.
        """
        if self.na == 0:
            return np.zeros(0)
        gain = self.gains[min(max(age, 1), self.gains.size) - 1]
        return np.asarray(y_past + gain * (measured - y_past[0]), dtype=np.float64)

    def drive(self, inputs: FloatArray) -> FloatArray:
        """(T,) what the inputs (T, n) contribute to each step, in scaled units; NaN in the first lags - 1 rows."""
        u = (np.clip(inputs, self.u_low, self.u_high) - self.u_mean) / self.u_std
        total = np.full(len(u), self.intercept)
        total[: self.lags - 1] = np.nan
        first = self.lags - 1
        for s, b in enumerate(self.b):
            for j, coefficient in enumerate(b):
                total[first:] += coefficient * u[first - j : len(u) - j, s]
        return total

    def free_run(self, inputs: FloatArray, y_measured: FloatArray, y_start: float | None = None) -> FloatArray:
        """(T,) predictions over a record, each made before that row's measurement; NaN before the first is possible.

        inputs: (T, n) consecutive grid steps of the chosen inputs, physical units, finite. y_measured: (T,) with NaN
        where nothing was measured; a measured row is a state update. y_start: the output before the first prediction
        (all of the history); None: the first measured value, which warm machines need: from zero the error doubles.
        """
        inputs = np.ascontiguousarray(inputs, dtype=np.float64)
        y_measured = np.ascontiguousarray(y_measured, dtype=np.float64)
        if inputs.ndim != 2 or inputs.shape[1] != len(self.inputs):
            raise ValueError(f"inputs has shape {inputs.shape}: expected (T, {len(self.inputs)})")
        if y_measured.shape != (len(inputs),):
            raise ValueError(f"y_measured has shape {y_measured.shape}: expected {(len(inputs),)}")
        if not np.isfinite(inputs).all():
            raise ValueError("inputs holds a value that is not finite: replace missing values first")
        predicted = np.full(len(inputs), np.nan)
        first = self.lags - 1
        if len(inputs) <= first:
            return predicted
        scaled = (y_measured - self.y_mean) / self.y_std
        if y_start is None:
            known = np.flatnonzero(np.isfinite(scaled))
            start = scaled[known[0]] if known.size else 0.0
        else:
            start = (y_start - self.y_mean) / self.y_std
        history = np.full(self.na, start)
        out = np.empty(len(inputs) - first)
        low, high = (self.y_low - self.y_mean) / self.y_std, (self.y_high - self.y_mean) / self.y_std
        _kernel.free_run(self.a, self.drive(inputs)[first:], scaled[first:], self.gains, low, high, 0, history, out)
        predicted[first:] = out * self.y_std + self.y_mean
        return predicted

    def to_dict(self) -> dict[str, Any]:
        """JSON-able; floats come back bit for bit."""
        plain: dict[str, Any] = {f.name: getattr(self, f.name) for f in fields(self)}
        for name in ("a", "u_mean", "u_std", "u_low", "u_high"):
            plain[name] = plain[name].tolist()
        plain["inputs"] = list(self.inputs)
        plain["b"] = [b.tolist() for b in self.b]
        plain["disturbance"] = {f.name: getattr(self.disturbance, f.name) for f in fields(Disturbance)}
        return plain

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any]) -> "ErrorModel":
        """The inverse of `to_dict`. ValueError names missing and unknown fields."""
        expected = {f.name for f in fields(cls)}
        if set(plain) != expected:
            raise ValueError(f"a model's fields differ from the expected ones in {sorted(set(plain) ^ expected)}")
        return cls(**{**plain, "disturbance": Disturbance(**plain["disturbance"])})


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ModelSet:
    """The models of the nine thermal errors from one training."""

    k: int
    """Grid index of the training's last row."""
    why: str
    """Why the training was wanted (a talc.frame.Why)."""
    input_names: tuple[str, ...]
    """The inputs that were offered."""
    models: tuple[ErrorModel | None, ...]
    """In the order of THERMAL_ERRORS; None: no usable model for that error."""
    notes: tuple[str, ...] = ()
    """What the training has to say: inputs not offered, fall-backs, errors without a model."""

    def __post_init__(self) -> None:
        if len(self.models) != len(THERMAL_ERRORS):
            raise ValueError(f"models has {len(self.models)} entries: expected {len(THERMAL_ERRORS)}")
        for name, model in zip(THERMAL_ERRORS, self.models, strict=True):
            if model is not None and model.error != name:
                raise ValueError(f"models holds one of {model.error} in the place of {name}")
            if model is not None and not set(model.inputs) <= set(self.input_names):
                raise ValueError(f"the model of {name} needs {model.inputs}, which were not all offered")

    def fingerprint(self) -> str:
        """SHA-256 over the canonical JSON, in hexadecimal: equal exactly when all numbers are equal."""
        canonical = json.dumps(self.to_dict(), sort_keys=True, separators=(",", ":"), allow_nan=False)
        return hashlib.sha256(canonical.encode()).hexdigest()

    def to_dict(self) -> dict[str, Any]:
        """JSON-able; floats come back bit for bit."""
        return {
            "k": self.k,
            "why": str(self.why),
            "input_names": list(self.input_names),
            "models": [None if m is None else m.to_dict() for m in self.models],
            "notes": list(self.notes),
        }

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any]) -> "ModelSet":
        """The inverse of `to_dict`."""
        return cls(
            k=plain["k"],
            why=plain["why"],
            input_names=tuple(plain["input_names"]),
            models=tuple(None if m is None else ErrorModel.from_dict(m) for m in plain["models"]),
            notes=tuple(plain["notes"]),
        )
