"""Bodies and lumped parts joined to one heat network by the table `machine.toml`; whole or reduced bodies alike."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import block_diag, csc_matrix, diags_array

from simulators.plant.body import BodyModel, FloatArray
from talc.names import THERMAL_ERRORS

ZONES = ("left", "right", "front", "rear", "high", "ground")
FAMILIES = ("flow", "wet", "table", "nose")


@dataclass(frozen=True, slots=True)
class Joined:
    """C dT/dt = -(K + sum h_i H_i) T + G T_zones + q over n coordinates: those of the bodies, then the nodes."""

    places: Mapping[str, FloatArray]
    """(n,) rows that give the mean temperature of a patch or node"""
    points: Mapping[str, FloatArray]
    C: csc_matrix
    K: csc_matrix
    """symmetric"""
    outside: FloatArray
    """(n, z) W/K"""
    films: tuple[csc_matrix, ...]
    """in the order of FAMILIES; all but the coolant's one-way `flow` symmetric"""
    heat_to: FloatArray
    """(n, s) J/s in each coordinate for 1 W of each source"""
    even: FloatArray
    """(n,) coordinates of 1 K everywhere"""
    elastic: FloatArray
    """(9, n) µm/K, µm/m/K for the last three"""
    growth: FloatArray
    """(n,) µm/K of the shaft against the housing's front face"""


class _Joiner:
    """Places in the joint vector, and matrices that are summed up."""

    def __init__(self, table: Mapping[str, Any], bodies: Mapping[str, BodyModel]) -> None:
        self.bodies, self.nodes = bodies, tuple(table["node"])
        self.start, count = {}, 0
        for name, body in bodies.items():
            self.start[name] = count
            count += body.C.shape[0]
        self.first_node, self.n = count, count + len(self.nodes)
        self.K = csc_matrix((self.n, self.n))
        self.outside = np.zeros((self.n, len(ZONES)))

    def spread(self, body: str, row: FloatArray) -> FloatArray:
        whole = np.zeros(self.n)
        whole[self.start[body] : self.start[body] + row.size] = row
        return whole

    def place(self, name: str, where: str) -> FloatArray:
        """(n,) row of a mean temperature. ValueError if there is no such patch or node."""
        if name in self.nodes:
            whole = np.zeros(self.n)
            whole[self.first_node + self.nodes.index(name)] = 1.0
            return whole
        body = name.split(".")[0]
        if body not in self.bodies or name not in self.bodies[body].faces:
            raise ValueError(f"{where}: no patch or node {name!r}")
        face = self.bodies[body].faces[name]
        return self.spread(body, face.g / face.area)

    def between(self, first: str, second: str, row: Mapping[str, Any], where: str) -> csc_matrix:
        """(n, n) symmetric, positive semidefinite: heat between two places of the vector."""
        a, b = csc_matrix(self.place(first, where)), csc_matrix(self.place(second, where))
        if "G_W_K" in row:
            apart = a - b
            return csc_matrix(row["G_W_K"] * (apart.T @ apart))
        if first in self.nodes or second not in self.nodes:
            raise ValueError(f"{where}: a film needs 'patch - node' or 'patch - zone'")
        body, h = first.split(".")[0], row["h_W_m2K"] * row.get("share", 1.0)
        face, at = self.bodies[body].faces[first], self.start[body]
        # sum h (T - T_node)^2 over the patch: H, the border -g, and the area on the node's diagonal.
        before, after = at, self.n - at - face.H.shape[0]
        own = block_diag([csc_matrix((before, before)), face.H, csc_matrix((after, after))])
        cross = face.area * (a.T @ b)
        return csc_matrix(h * (own - cross - cross.T + face.area * (b.T @ b)))

    def towards(self, place: str, zone: str, row: Mapping[str, Any], where: str) -> None:
        """A film towards a zone of the hall."""
        column = ZONES.index(zone)
        if place in self.nodes:
            conductance = row["h_W_m2K"] * row["area_m2"]
            unit = csc_matrix(self.place(place, where))
            self.K = self.K + conductance * (unit.T @ unit)
            self.outside[:, column] += conductance * self.place(place, where)
            return
        self.place(place, where)
        body, h = place.split(".")[0], row["h_W_m2K"] * row.get("share", 1.0)
        face, at = self.bodies[body].faces[place], self.start[body]
        after = self.n - at - face.H.shape[0]
        self.K = self.K + h * block_diag([csc_matrix((at, at)), face.H, csc_matrix((after, after))])
        self.outside[:, column] += h * self.spread(body, face.g)


def join(table: Mapping[str, Any], bodies: Mapping[str, BodyModel]) -> Joined:
    """The network of `table` over `bodies`. ValueError names an entry that cannot be."""
    j = _Joiner(table, bodies)
    masses = [row["mass_kg"] * row["c_J_kgK"] for row in table["node"].values()]
    lumps = csc_matrix((len(masses), len(masses)))
    j.K = csc_matrix(block_diag([body.K for body in bodies.values()] + [lumps]))
    for pair, row in table["conduction"].items():
        first, second = _ends(pair, "conduction")
        j.K = j.K + j.between(first, second, row, f"conduction {pair!r}")
    for pair, row in table["air"].items():
        first, second = _ends(pair, "air")
        if second in ZONES:
            j.towards(first, second, row, f"air {pair!r}")
        else:
            j.K = j.K + j.between(first, second, row, f"air {pair!r}")
    films = [csc_matrix((j.n, j.n)) for _ in FAMILIES]
    for pair, row in table["film"].items():
        first, second = _ends(pair, "film")
        k = FAMILIES.index(row["family"])
        films[k] = films[k] + j.between(first, second, row, f"film {pair!r}")
    rate, path = table["flow"]["rate_W_K"], table["flow"]["path"]
    for before, after in zip([path[-1], *path], path, strict=False):
        here, there = csc_matrix(j.place(after, "flow.path")), csc_matrix(j.place(before, "flow.path"))
        films[0] = films[0] + rate * (here.T @ (here - there))
    alpha = {name: row["alpha"] for name, row in table["expansion"].items()}
    elastic = np.zeros((len(THERMAL_ERRORS) + 1, j.n))
    for name, body in bodies.items():
        elastic[:, j.start[name] : j.start[name] + body.C.shape[0]] = alpha[name] * body.elastic
    shaft = alpha["shaft"] * table["tool"]["shaft_m"] * j.place("sp_shaft", "tool")
    elastic[THERMAL_ERRORS.index("EZ0A")] += shaft
    post = alpha["artefact"] * table["tool"]["artefact_m"] * j.place("table.top", "tool")
    elastic[THERMAL_ERRORS.index("EZ0T")] += post
    places = [*j.nodes, *(name for body in bodies.values() for name in body.faces)]
    return Joined(
        places={name: j.place(name, "places") for name in places},
        points={name: j.spread(body, row) for body, m in bodies.items() for name, row in m.points.items()},
        C=csc_matrix(block_diag([body.C for body in bodies.values()] + [diags_array(np.array(masses, dtype=float))])),
        K=csc_matrix(j.K),
        outside=j.outside,
        films=tuple(csc_matrix(film) for film in films),
        heat_to=np.column_stack([_shares(j, name, row["to"]) for name, row in table["heat"].items()]),
        even=np.concatenate([*(body.even for body in bodies.values()), np.ones(len(masses))]),
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
