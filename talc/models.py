"""The model of one thermal error, and the set of nine (Z22 eq. 1 and 2).

In scaled units (z-scores of the training window, eq. 1) a model is

    y[k] = intercept - sum_{i=1..na} a_i y[k-i] + sum_s sum_{j=0..nb_s} b_sj u_s[k-j]

Static and FIR models are the case na = 0. Outputs that were not measured are the model's own predictions (free run).
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from talc import _kernel
from talc.disturbance import Disturbance
from talc.frame import FloatArray
from talc.kinds import EventCode
from talc.names import THERMAL_ERRORS


def _frozen_array(values: object) -> FloatArray:
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


@dataclass(frozen=True, kw_only=True, eq=False)
class ErrorModel:
    """The model of one thermal error. Arrays are copied and read-only. ValueError names an invalid field.

    Bounds: every input is held within `[u_low, u_high]` and every prediction within `[y_low, y_high]`, which extend one
    training range beyond the training data on either side; a prediction that was affected is flagged.
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
    """Largest |free-run residual| on rows that the fit has not seen: the adaptive control limit; µm or µm/m."""
    training_limit: float
    """The same over the rows of the fit itself, as in Z22; too narrow for days that differ from training."""
    residual_std: float
    """Root mean square of the fit's own residuals."""
    criterion: float
    """The value that the selection minimised."""
    disturbance: Disturbance = field(default_factory=Disturbance)
    leverage: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    """(p, p) inverse of X'X / n of training's filtered inputs, p coefficients input by input; empty: no input, or
    unknown."""
    leverage_limit: float = 0.0
    """Largest leverage x' (X'X / n)^-1 x in training; beyond it an input is novel and the uncertainty grows."""
    novelty_std: float = 0.0
    """Standard deviation that corresponds to a leverage of 1; µm or µm/m."""
    resets_history: bool = False
    """A measurement replaces the model's past outputs (Z22's state update); otherwise it moves the disturbance."""

    def __post_init__(self) -> None:
        for name in ("a", "u_mean", "u_std", "u_low", "u_high", "leverage"):
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
        numbers.append(
            np.array(
                [self.intercept, self.y_mean, self.y_std, self.y_low, self.y_high, self.limit, self.training_limit]
            )
        )
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

    def poles(self) -> NDArray[np.complex128]:
        """(na,) roots of z^na + a_1 z^(na-1) + ... ."""
        return np.roots(np.concatenate([[1.0], self.a])).astype(np.complex128)

    def static_gain(self) -> FloatArray:
        """(n,) response to a lasting unit step of each input; µm or µm/m per unit of the input."""
        sums = np.array([b.sum() for b in self.b])
        return np.asarray(sums / (1.0 + self.a.sum()) * self.y_std / self.u_std, dtype=np.float64)

    def runner(self) -> _kernel.Runner:
        """The model in operation: it keeps the state between steps."""
        d, coefficients = self.disturbance, sum(b.size for b in self.b)
        return _kernel.Runner(
            a=self.a,
            b=[b.tolist() for b in self.b],
            intercept=self.intercept,
            u_mean=self.u_mean,
            u_std=self.u_std,
            u_low=self.u_low,
            u_high=self.u_high,
            y_mean=self.y_mean,
            y_std=self.y_std,
            y_low=self.y_low,
            y_high=self.y_high,
            resets_history=self.resets_history,
            spread=self.residual_std,
            leverage=self.leverage if self.leverage.size else np.zeros((coefficients, coefficients)),
            leverage_limit=self.leverage_limit,
            novelty_std=self.novelty_std,
            pole=d.poles,
            drift=d.drifts,
            noise=d.noise_std,
            weight=d.log_weights,
        )

    def free_run(self, inputs: FloatArray, y_measured: FloatArray, y_start: float | None = None) -> FloatArray:
        """(T,) predictions over a record, each made before that row's measurement. Before it the inputs stood still.

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
        if y_start is None:
            known = y_measured[np.isfinite(y_measured)]
            y_start = float(known[0]) if known.size else self.y_mean
        runner = self.runner()
        runner.start(y_start)
        predicted = np.empty(len(inputs))
        runner.run(inputs, y_measured, True, predicted)
        return predicted

    def to_dict(self) -> dict[str, Any]:
        """JSON-able; floats come back bit for bit."""
        plain: dict[str, Any] = {f.name: getattr(self, f.name) for f in fields(self)}
        for name in ("a", "u_mean", "u_std", "u_low", "u_high", "leverage"):
            plain[name] = plain[name].tolist()
        plain["inputs"] = list(self.inputs)
        plain["b"] = [b.tolist() for b in self.b]
        plain["disturbance"] = self.disturbance.to_dict()
        return plain

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any]) -> "ErrorModel":
        """The inverse of `to_dict`. ValueError names missing and unknown fields."""
        expected = {f.name for f in fields(cls)}
        if set(plain) != expected:
            raise ValueError(f"a model's fields differ from the expected ones in {sorted(set(plain) ^ expected)}")
        return cls(**{**plain, "disturbance": Disturbance.from_dict(plain["disturbance"])})


@dataclass(frozen=True, slots=True)
class TrainingNote:
    """A remark of a training."""

    code: str
    """Of talc.kinds.EventCode, or of whoever made the models."""
    values: Mapping[str, Any] = field(default_factory=dict, hash=False)
    """What belongs to the code."""

    def to_plain(self) -> str | dict[str, Any]:
        """JSON-able. The words of an earlier program are words again."""
        if self.code == EventCode.TRAINING_NOTE:
            return str(self.values["note"])
        return {"code": str(self.code), "values": dict(self.values)}

    @classmethod
    def from_plain(cls, plain: str | Mapping[str, Any]) -> "TrainingNote":
        """The inverse of `to_plain`."""
        if isinstance(plain, str):
            return cls(EventCode.TRAINING_NOTE, {"note": plain})
        return cls(plain["code"], plain["values"])

    def __str__(self) -> str:
        values = ", ".join(f"{name} {value}" for name, value in self.values.items() if name != "error")
        return f"{self.code.replace('_', ' ')} ({values})"


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
    notes: tuple[TrainingNote, ...] = ()
    """Remarks of the training: inputs not offered, errors without a model."""
    failed: bool = False
    """They stand for a training that ended without a result: there is no model, and the former ones stay."""

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
        canonical = json.dumps(self._numbers(), sort_keys=True, separators=(",", ":"), allow_nan=False)
        return hashlib.sha256(canonical.encode()).hexdigest()

    def to_dict(self) -> dict[str, Any]:
        """JSON-able; floats come back bit for bit."""
        return self._numbers() | ({"failed": True} if self.failed else {})

    def _numbers(self) -> dict[str, Any]:
        return {
            "k": self.k,
            "why": str(self.why),
            "input_names": list(self.input_names),
            "models": [None if m is None else m.to_dict() for m in self.models],
            "notes": [note.to_plain() for note in self.notes],
        }

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any]) -> "ModelSet":
        """The inverse of `to_dict`."""
        models = tuple(None if m is None else ErrorModel.from_dict(m) for m in plain["models"])
        notes = tuple(map(TrainingNote.from_plain, plain["notes"]))
        # Earlier programs did not say so. A training that ends gives a remark on each error without a model.
        failed = plain.get("failed", len(notes) == 1 and not any(models))
        return cls(
            k=plain["k"],
            why=plain["why"],
            input_names=tuple(plain["input_names"]),
            models=models,
            notes=notes,
            failed=failed,
        )
