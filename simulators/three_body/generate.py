"""Makes reduced.json: `python -m simulators.three_body.generate` (needs the `study` extra)."""

import json
from pathlib import Path

import numpy as np
from scipy.linalg import eigh, solve_continuous_lyapunov, svd
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

from simulators.plant import FloatArray
from simulators.three_body.model import ThreeBody
from simulators.three_body.solid import Solid, assemble

_STATES = 14  # the fewest that keep drift within 0.02 µm; with 12 it is 0.0213 in the steady state
_SHIFTS = np.logspace(-6, -2, 9)  # 1/s: from beyond the slowest mode to below the 5-min step


def reduce_whole(solid: Solid, states: int = _STATES) -> ThreeBody:
    """Rational Krylov space of inputs and outputs, then balanced truncation (Antoulas 2005, ch. 7 and 11)."""
    sides = np.column_stack([solid.S, solid.D.T])
    blocks = []
    for shift in (0.0, *_SHIFTS):
        factor = splu(csc_matrix(solid.K + solid.H + shift * solid.C))
        once = factor.solve(sides)
        blocks += [once, factor.solve(solid.C @ once)]
    space = np.hstack(blocks)
    space /= np.sqrt(np.einsum("ij,ij->j", space, solid.C @ space))
    # Directions that depend on others within rounding are dropped; the rest is orthonormal in C.
    size, turn = eigh(space.T @ (solid.C @ space))
    keep = size > 1e-12 * size[-1]
    basis = space @ (turn[:, keep] / np.sqrt(size[keep]))
    a = -basis.T @ ((solid.K + solid.H) @ basis)
    a = (a + a.T) / 2
    b, d = basis.T @ solid.S, solid.D @ basis
    reach, watch = solve_continuous_lyapunov(a, -b @ b.T), solve_continuous_lyapunov(a, -d.T @ d)
    left, right = _root(reach), _root(watch)
    u, s, vt = svd(right.T @ left)
    scale = 1 / np.sqrt(s[:states])
    into, out = left @ vt[:states].T * scale, right @ u[:, :states] * scale
    return ThreeBody(A=out.T @ a @ into, B=out.T @ b, D=d @ into)


def _root(gramian: FloatArray) -> FloatArray:
    """L with L L' = the Gramian, which rounding leaves slightly indefinite."""
    values, vectors = eigh((gramian + gramian.T) / 2)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0)), dtype=np.float64)


def main() -> None:
    """Write the matrices beside this file."""
    model = reduce_whole(assemble())
    stored = {name: getattr(model, name).tolist() for name in ("A", "B", "D")}
    path = Path(__file__).with_name("reduced.json")
    path.write_text(json.dumps(stored, indent=0) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
