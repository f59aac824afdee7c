"""Makes reduced/*.json: `python -m simulators.plant.generate [NAME ...]` (needs the `study` extra; a minute each)."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click
import numpy as np
from scipy.linalg import eigh
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

from simulators.plant.body import BodyModel, FloatArray
from simulators.plant.joined import Joined, join
from simulators.plant.parameters import HERE, MACHINES, machine_tables
from simulators.plant.shape import read_shape
from simulators.plant.solid import SparseSum, assemble_bodies

CONDITIONS = ((0, 0, 0, 0), (1, 0, 0, 0), (1, 1, 0, 0), (1, 0, 1, 1))
"""Factors of the films: off, powered, wet, everything turning."""
SHIFTS = (1e-7, *np.logspace(-5.5, -2.5, 7).tolist())
"""1/s: from the steady state to below the 5-min step."""
TOLERANCE_K = 0.2
"""Directions that contribute less than this to the snapshots of all causes are omitted."""
TOLERANCE_WATCHED = 1.0
"""The same for the adjoint snapshots, which determine the errors; they are scaled to 1 K on average."""
_ZONE_K, _CHILLER_W = 3.0, 1000.0


def snapshots(joined: Joined, table: Mapping[str, Any]) -> tuple[FloatArray, FloatArray]:
    """(n, m) K each: responses to every source at full load and to every zone; and adjoint solutions for each error.

    A rational Krylov space: solutions at real shifts (Antoulas 2005, ch. 11), for dry, wet and turning machines.
    """
    watts = [row.get("standby", 0) + row.get("linear", 0) + row["power"] for row in table["heat"].values()]
    chiller = _CHILLER_W * joined.places["coolant_tank"]
    causes = np.column_stack([joined.heat_to * np.array(watts), _ZONE_K * joined.outside, chiller])
    watched = np.vstack([joined.elastic, joined.growth]).T
    there, back = [], []
    for factors in CONDITIONS:
        rate = joined.K
        for factor, film in zip(factors, joined.films, strict=True):
            rate = rate + factor * film
        for shift in SHIFTS:
            solver = splu(csc_matrix(rate + shift * joined.C))
            there.append(solver.solve(causes))
            row = solver.solve(watched, "T")  # type: ignore[call-overload]
            back.append(row / np.sqrt(np.einsum("ij,ij->j", row, joined.C @ row) / joined.C.sum()))
    return np.hstack(there), np.hstack(back)


def basis(body: BodyModel, there: FloatArray, back: FloatArray) -> FloatArray:
    """(n, r) the uniform warming and the directions that the snapshots need most, orthonormal in C."""
    heat = float(body.even @ (body.C @ body.even))

    def principal(columns: FloatArray, tolerance: float) -> FloatArray:
        rest = columns - np.outer(body.even, body.even @ (body.C @ columns) / heat)
        size, turn = eigh(rest.T @ (body.C @ rest) / heat)
        return np.asarray(rest @ (turn[:, size > tolerance**2] / np.sqrt(size[size > tolerance**2])), dtype=np.float64)

    both = np.column_stack([principal(there, TOLERANCE_K), principal(back, TOLERANCE_WATCHED)])
    distinct = principal(both, 1e-4)
    return np.asarray(np.column_stack([body.even, distinct]) / np.sqrt(heat), dtype=np.float64)


def reduce_bodies(table: Mapping[str, Any], bodies: Mapping[str, BodyModel]) -> dict[str, BodyModel]:
    """Each body in its own basis, so that joints, films and losses can still be changed afterwards."""
    there, back = snapshots(join(table, bodies, SparseSum), table)
    small, at = {}, 0
    for name, body in bodies.items():
        own = slice(at, at + body.C.shape[0])
        small[name] = body.project(basis(body, there[own], back[own]))
        at = own.stop
    return small


def stored(bodies: Mapping[str, BodyModel]) -> dict[str, Any]:
    """As JSON; symmetric matrices by their lower triangle, row after row. C is the identity."""
    return {
        name: {
            "K": _lower(body.K),
            "faces": {patch: {"H": _lower(f.H), "g": f.g.tolist(), "area": f.area} for patch, f in body.faces.items()},
            "points": {point: row.tolist() for point, row in body.points.items()},
            "even": body.even.tolist(),
            "elastic": body.elastic.tolist(),
        }
        for name, body in bodies.items()
    }


def _lower(dense: FloatArray) -> list[float]:
    return [float(v) for v in dense[np.tril_indices(len(dense))]]


_SHAPED = tuple(name for name in MACHINES if machine_tables(name).reduced == name)


@click.command()
@click.argument("names", nargs=-1, type=click.Choice(_SHAPED), metavar="[NAME ...]")
@click.option("--folder", type=click.Path(file_okay=False, path_type=Path), default=HERE / "reduced",
              help="Where the files go. Default: where the simulators read them.")  # fmt: skip
def main(names: tuple[str, ...], folder: Path) -> None:
    """Write the matrices of the machines NAME; without a name, of every machine that has its own shape."""
    for name in names or _SHAPED:
        chosen = machine_tables(name)
        small = reduce_bodies(chosen.machine, assemble_bodies(read_shape(chosen.shape)))
        path = folder / f"{name}.json"
        folder.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(stored(small)).replace("}, ", "},\n") + "\n", encoding="utf-8")
        states = {body: model.C.shape[0] for body, model in small.items()}
        click.echo(f"{path.name}: {states}, {sum(states.values())} states, {path.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
