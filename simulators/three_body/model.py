"""The reduced three-body model: fourteen states, stepped by the exact zero-order hold."""

import json
from dataclasses import dataclass
from importlib.resources import files

import numpy as np
from scipy.linalg import expm

from simulators.plant import FloatArray

SOURCES = ("base_front", "spindle_top")
"""Heat inputs, W."""
DRIFTS = ("X", "Y", "Z")
"""Tool minus workpiece, µm: the first three outputs."""
THERMOMETERS = ("base_near", "spindle_near", "base_far", "column_far")
"""Temperatures, the other outputs."""
AMBIENT_degC = 20.0


@dataclass(frozen=True, slots=True)
class ThreeBody:
    """dx/dt = A x + B q, y = D x: A (n, n) 1/s, B (n, 2), D (7, n): drifts in µm, then sensors in K over ambient."""

    A: FloatArray
    B: FloatArray
    D: FloatArray

    def respond(self, heat: FloatArray, dt_s: float = 300.0) -> tuple[FloatArray, FloatArray]:
        """From ambient, heat (steps, 2) W, each row held for dt_s. Drift (steps, 3) µm and sensors (steps, 4) degC.

        Row k is the state at the end of step k. ValueError if heat is not (steps, 2) or dt_s is not positive.
        """
        if heat.ndim != 2 or heat.shape[1] != len(SOURCES):
            raise ValueError(f"heat: expected (steps, {len(SOURCES)}), got {heat.shape}")
        if not dt_s > 0:
            raise ValueError(f"dt_s: expected a positive number of seconds, got {dt_s}")
        n = len(self.A)
        joined = np.zeros((n + len(SOURCES),) * 2)
        joined[:n, :n], joined[:n, n:] = self.A, self.B
        held = expm(joined * dt_s)
        keep, take = held[:n, :n], held[:n, n:]
        state = np.zeros(n)
        outputs = np.empty((len(heat), len(self.D)))
        for k, q in enumerate(heat):
            state = keep @ state + take @ q
            outputs[k] = self.D @ state
        return outputs[:, : len(DRIFTS)], outputs[:, len(DRIFTS) :] + AMBIENT_degC

    def steady(self, heat: FloatArray) -> FloatArray:
        """Outputs (7,) in the end under constant heat (2,) W: µm, then K over ambient."""
        return np.asarray(-self.D @ np.linalg.solve(self.A, self.B @ heat), dtype=np.float64)


def load_reduced() -> ThreeBody:
    """The committed matrices, made by `python -m simulators.three_body.generate`."""
    text = (files("simulators.three_body") / "reduced.json").read_text(encoding="utf-8")
    stored = json.loads(text)
    return ThreeBody(*(np.array(stored[name], dtype=np.float64) for name in ("A", "B", "D")))
