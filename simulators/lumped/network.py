"""Thermal nodes coupled by conduction and by convection that depends on flow, stepped implicitly."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Node:
    """A body of uniform temperature."""

    name: str
    mass_kg: float
    specific_heat: float
    """J/(kg K)"""
    area_m2: float = 0.0
    """Surface that gives heat to the air `air`."""
    film: float = 0.0
    """Film coefficient to that air, W/(m² K)."""
    air: str = ""

    @property
    def capacity(self) -> float:
        """J/K"""
        return self.mass_kg * self.specific_heat


@dataclass(frozen=True, slots=True)
class Link:
    """Conductance between two nodes, W/K; with `flow` it is multiplied by that flow (0 to 1) of the moment."""

    first: str
    second: str
    conductance: float
    flow: str = ""


class Network:
    """C dT/dt = -(K + sum_i flow_i(t) H_i) T + heat + K_boundary T_boundary, by the implicit Euler rule.

    The implicit rule is stable for every flow >= 0 and every step. Boundaries (hall air, weather) are given
    temperatures.

    Parameters
    ----------
    nodes, links: the bodies and what couples them; a link may name a boundary
    boundaries: names of given temperatures
    """

    def __init__(self, nodes: Sequence[Node], links: Sequence[Link], boundaries: Sequence[str]) -> None:
        self.names = tuple(node.name for node in nodes)
        self.boundaries = tuple(boundaries)
        self._index = {name: i for i, name in enumerate((*self.names, *self.boundaries))}
        if len(self._index) != len(nodes) + len(boundaries):
            raise ValueError("a node or boundary is named twice")
        self.capacity: Array = np.array([node.capacity for node in nodes])
        convection = [Link(n.name, n.air, n.area_m2 * n.film) for n in nodes if n.area_m2]
        self.flows = tuple(sorted({link.flow for link in links if link.flow}))
        self._fixed = self._laplacian([link for link in (*links, *convection) if not link.flow])
        self._by_flow = {f: self._laplacian([link for link in links if link.flow == f]) for f in self.flows}

    def index(self, name: str) -> int:
        """Position of a node. KeyError: there is none of that name."""
        return self._index[name]

    def conductance(self, flows: Mapping[str, float]) -> Array:
        """(n, n + boundaries) K in W/K; rows are nodes and sum to zero: heat goes nowhere by itself."""
        total = self._fixed.copy()
        for flow, matrix in self._by_flow.items():
            total += flows[flow] * matrix
        return total

    def step(self, temperatures: Array, dt_s: float, heat: Array, flows: Mapping[str, float], boundary: Array) -> Array:
        """(n,) temperatures, degC, after `dt_s` with (n,) heat in W and (boundaries,) temperatures in degC."""
        n = len(self.names)
        k = self.conductance(flows)
        matrix = np.diag(self.capacity / dt_s) + k[:, :n]
        right = self.capacity / dt_s * temperatures + heat - k[:, n:] @ boundary
        return np.asarray(np.linalg.solve(matrix, right), dtype=np.float64)

    def steady_state(self, heat: Array, flows: Mapping[str, float], boundary: Array) -> Array:
        """(n,) temperatures that no longer change."""
        n = len(self.names)
        k = self.conductance(flows)
        return np.asarray(np.linalg.solve(k[:, :n], heat - k[:, n:] @ boundary), dtype=np.float64)

    def _laplacian(self, links: Sequence[Link]) -> Array:
        n, total = len(self.names), len(self._index)
        full = np.zeros((total, total))
        for link in links:
            if link.conductance < 0:
                raise ValueError(f"link {link.first} - {link.second}: conductance {link.conductance} is below 0")
            i, j = self._index[link.first], self._index[link.second]
            full[i, i] += link.conductance
            full[j, j] += link.conductance
            full[i, j] -= link.conductance
            full[j, i] -= link.conductance
        return full[:n]
