"""Joins bodies and lumped parts to one heat network by the table `machine.toml`; for full and reduced bodies."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from simulators.plant.body import BodyModel, FloatArray, Matrix
from talc.names import THERMAL_ERRORS

ZONES = ("left", "right", "front", "rear", "high", "ground")
FAMILIES = ("flow", "wet", "table", "nose")


@dataclass(frozen=True, slots=True)
class Joined:
    """C dT/dt = -(K + sum h_i H_i) T + G T_zones + q over n coordinates: those of the bodies, then the nodes."""

    places: Mapping[str, FloatArray]
    """(n,) rows that give the mean temperature of a patch or node"""
    points: Mapping[str, FloatArray]
    C: Matrix
    K: Matrix
    """symmetric"""
    outside: FloatArray
    """(n, z) W/K"""
    films: tuple[Matrix, ...]
    """in the order of FAMILIES; all but the coolant's one-way `flow` symmetric"""
    heat_to: FloatArray
    """(n, s) J/s in each coordinate for 1 W of each source"""
    even: FloatArray
    """(n,) coordinates of 1 K everywhere"""
    elastic: FloatArray
    """(9, n) µm/K, µm/m/K for the last three"""
    growth: FloatArray
    """(n,) µm/K of the shaft against the housing's front face"""


class Sum(Protocol):
    """A matrix (n, n) that is accumulated, starting at zero; dense or sparse."""

    def __init__(self, n: int) -> None: ...
    def block(self, at: int, matrix: Matrix, weight: float) -> None:
        """Add weight * matrix from row and column `at` on."""

    def outer(self, left: FloatArray, right: FloatArray, weight: float) -> None:
        """Add weight * left right'."""

    def matrix(self) -> Matrix: ...


class DenseSum:
    """For reduced bodies."""

    def __init__(self, n: int) -> None:
        self._total = np.zeros((n, n))

    def block(self, at: int, matrix: Matrix, weight: float) -> None:
        self._total[at : at + len(matrix), at : at + len(matrix)] += weight * matrix

    def outer(self, left: FloatArray, right: FloatArray, weight: float) -> None:
        self._total += weight * np.outer(left, right)

    def matrix(self) -> FloatArray:
        return self._total


class _Joiner:
    """The position of each place in the joint vector."""

    def __init__(self, table: Mapping[str, Any], bodies: Mapping[str, BodyModel]) -> None:
        self.bodies, self.nodes = bodies, tuple(table["node"])
        self.start, count = {}, 0
        for name, body in bodies.items():
            self.start[name] = count
            count += body.even.size
        self.n = count + len(self.nodes)
        self._first_node = count

    def spread(self, body: str, row: FloatArray) -> FloatArray:
        whole = np.zeros(self.n)
        whole[self.start[body] : self.start[body] + row.size] = row
        return whole

    def place(self, name: str, where: str) -> FloatArray:
        """(n,) row of a mean temperature. ValueError if the patch or node does not exist."""
        if name in self.nodes:
            whole = np.zeros(self.n)
            whole[self._first_node + self.nodes.index(name)] = 1.0
            return whole
        body = name.split(".")[0]
        if body not in self.bodies or name not in self.bodies[body].faces:
            raise ValueError(f"{where}: no patch or node {name!r}")
        face = self.bodies[body].faces[name]
        return self.spread(body, face.g / face.area)

    def between(self, total: Sum, first: str, second: str, row: Mapping[str, Any], where: str) -> None:
        """Add heat flow between two places: symmetric, positive semidefinite."""
        a, b = self.place(first, where), self.place(second, where)
        if "G_W_K" in row:
            total.outer(a - b, a - b, row["G_W_K"])
            return
        if first in self.nodes or second not in self.nodes:
            raise ValueError(f"{where}: a film needs 'patch - node' or 'patch - zone'")
        body, h = first.split(".")[0], row["h_W_m2K"] * row.get("share", 1.0)
        face = self.bodies[body].faces[first]
        # sum h (T - T_node)^2 over the patch: H, the border -g, and the area on the node's diagonal.
        total.block(self.start[body], face.H, h)
        total.outer(a, b, -h * face.area)
        total.outer(b, a, -h * face.area)
        total.outer(b, b, h * face.area)

    def towards(self, total: Sum, place: str, row: Mapping[str, Any], where: str) -> FloatArray:
        """Add a film towards a zone of the hall; (n,) W/K of that zone."""
        mean = self.place(place, where)
        if place in self.nodes:
            conductance = row["h_W_m2K"] * row["area_m2"]
            total.outer(mean, mean, conductance)
            return np.asarray(conductance * mean, dtype=np.float64)
        body, h = place.split(".")[0], row["h_W_m2K"] * row.get("share", 1.0)
        face = self.bodies[body].faces[place]
        total.block(self.start[body], face.H, h)
        return np.asarray(h * self.spread(body, face.g), dtype=np.float64)


def join(table: Mapping[str, Any], bodies: Mapping[str, BodyModel], kind: type[Sum] = DenseSum) -> Joined:
    """The network of `table` over `bodies`; `kind` accumulates their matrices. ValueError names an invalid entry."""
    j = _Joiner(table, bodies)
    storage, rate, films = kind(j.n), kind(j.n), [kind(j.n) for _ in FAMILIES]
    outside = np.zeros((j.n, len(ZONES)))
    for name, body in bodies.items():
        storage.block(j.start[name], body.C, 1.0)
        rate.block(j.start[name], body.K, 1.0)
    for name, row in table["node"].items():
        storage.outer(j.place(name, "node"), j.place(name, "node"), row["mass_kg"] * row["c_J_kgK"])
    for pair, row in table["conduction"].items():
        first, second = _ends(pair, "conduction")
        j.between(rate, first, second, row, f"conduction {pair!r}")
    for pair, row in table["air"].items():
        first, second = _ends(pair, "air")
        if second in ZONES:
            outside[:, ZONES.index(second)] += j.towards(rate, first, row, f"air {pair!r}")
        else:
            j.between(rate, first, second, row, f"air {pair!r}")
    for pair, row in table["film"].items():
        first, second = _ends(pair, "film")
        j.between(films[FAMILIES.index(row["family"])], first, second, row, f"film {pair!r}")
    carried, path = table["flow"]["rate_W_K"], table["flow"]["path"]
    for before, after in zip([path[-1], *path], path, strict=False):
        here, there = j.place(after, "flow.path"), j.place(before, "flow.path")
        films[FAMILIES.index("flow")].outer(here, here - there, carried)
    alpha = {name: row["alpha"] for name, row in table["expansion"].items()}
    elastic = np.zeros((len(THERMAL_ERRORS) + 1, j.n))
    for name, body in bodies.items():
        elastic[:, j.start[name] : j.start[name] + body.even.size] = alpha[name] * body.elastic
    shaft = alpha["shaft"] * table["tool"]["shaft_m"] * j.place("sp_shaft", "tool")
    elastic[THERMAL_ERRORS.index("EZ0A")] += shaft
    post = alpha["artefact"] * table["tool"]["artefact_m"] * j.place("table.top", "tool")
    elastic[THERMAL_ERRORS.index("EZ0T")] += post
    places = [*j.nodes, *(name for body in bodies.values() for name in body.faces)]
    return Joined(
        places={name: j.place(name, "places") for name in places},
        points={name: j.spread(body, row) for body, m in bodies.items() for name, row in m.points.items()},
        C=storage.matrix(),
        K=rate.matrix(),
        outside=outside,
        films=tuple(film.matrix() for film in films),
        heat_to=np.column_stack([_shares(j, name, row["to"]) for name, row in table["heat"].items()]),
        even=np.concatenate([*(body.even for body in bodies.values()), np.ones(len(j.nodes))]),
        elastic=elastic[:-1],
        growth=elastic[-1] + shaft,
    )


def _ends(pair: str, where: str) -> tuple[str, str]:
    ends = [end.strip() for end in pair.split(" - ")]
    if len(ends) != 2:
        raise ValueError(f"{where} {pair!r}: expected 'place - place'")
    return ends[0], ends[1]


def _shares(j: _Joiner, name: str, shares: Mapping[str, float]) -> FloatArray:
    if abs(sum(shares.values()) - 1) > 1e-9:
        raise ValueError(f"heat.{name}: the shares in `to` must sum to 1")
    column = np.zeros(j.n)
    for place, share in shares.items():
        column += share * j.place(place, f"heat.{name}")
    return column
