"""The machine's parameter table (`machine.toml`) as matrices. Units are in the table's key names."""

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from talc.names import THERMAL_ERRORS

FloatArray = NDArray[np.float64]

ZONES = ("left", "right", "front", "rear", "high", "ground")
FAMILIES = ("flow", "wet", "table", "nose")
MACHINE = Path(__file__).with_name("machine.toml")


@dataclass(frozen=True, slots=True)
class HeatLaw:
    """W(n) = standby + linear r + power r**exponent with r = |n| / at; `viscous_per_K`: relative fall per K."""

    drive: str
    at: float
    standby: float
    linear: float
    power: float
    exponent: float
    viscous_per_K: float  # noqa: N815


@dataclass(frozen=True, slots=True)
class Parameters:
    """One machine. n nodes, z zones, f film families, s heat sources, c channels."""

    nodes: tuple[str, ...]
    capacity: FloatArray
    """(n,) J/K"""
    conductance: FloatArray
    """(n, n) W/K, rows sum to the conductance towards the zones"""
    outside: FloatArray
    """(n, z) W/K"""
    films: FloatArray
    """(f, n, n) W/K at factor 1, in the order of FAMILIES"""
    laws: tuple[HeatLaw, ...]
    heat_to: FloatArray
    """(n, s) share of each source that a node gets; columns sum to 1"""
    channels: tuple[str, ...]
    sensor_at: FloatArray
    """(c, n + z) weights"""
    lag_s: FloatArray
    """(c,)"""
    growth: FloatArray
    """(n,) µm/K at the eddy-current sensor"""
    elastic: FloatArray
    """(9, n) µm/K, µm/m/K for the last three"""
    flow_rate_W_K: float  # noqa: N815
    chiller_set_degC: float  # noqa: N815
    chiller_gain_W_K: float  # noqa: N815
    chiller_max_W: float  # noqa: N815

    def node(self, name: str) -> int:
        return self.nodes.index(name)


def _weights(table: dict[str, float], names: tuple[str, ...], where: str) -> FloatArray:
    row = np.zeros(len(names))
    for name, weight in table.items():
        if name not in names:
            raise ValueError(f"{where}: unknown place {name!r}; one of {', '.join(names)}")
        row[names.index(name)] = weight
    return row


def _factor(term: dict[str, Any]) -> float:
    """Length that multiplies alpha, so that the result is µm/K (or µm/m/K for a slope)."""
    if "growth_mm" in term:
        return float(term["growth_mm"]) * 1e3
    length, height = float(term["length_mm"]), float(term["height_mm"])
    if "lever_mm" in term:
        return length / height * float(term["lever_mm"]) * 1e3
    return length**2 / (2 * height) * 1e3 if term.get("sag") else length / height * 1e6


def _link(matrix: FloatArray, pair: str, value: float, nodes: tuple[str, ...]) -> None:
    ends = [end.strip() for end in pair.split(" - ")]
    if len(ends) != 2 or not set(ends) <= set(nodes):
        raise ValueError(f"{pair!r}: expected 'node - node'")
    i, j = (nodes.index(end) for end in ends)
    matrix[[i, j], [i, j]] += value
    matrix[[i, j], [j, i]] -= value


def load(path: Path = MACHINE) -> Parameters:
    """Read a parameter table. ValueError names an entry that cannot be."""
    table = tomllib.loads(path.read_text(encoding="utf-8"))
    nodes = tuple(table["node"])
    n = len(nodes)
    conductance, outside = np.zeros((n, n)), np.zeros((n, len(ZONES)))
    for pair, row in table["conduction"].items():
        value = row["G_W_K"] if "G_W_K" in row else row["k_W_mK"] * row["area_m2"] / row["length_m"]
        _link(conductance, pair, value, nodes)
    for pair, row in table["outside"].items():
        node, zone = (end.strip() for end in pair.split(" - "))
        value = row["h_W_m2K"] * row["area_m2"]
        conductance[nodes.index(node), nodes.index(node)] += value
        outside[nodes.index(node), ZONES.index(zone)] += value
    films = np.zeros((len(FAMILIES), n, n))
    for pair, row in table["film"].items():
        _link(films[FAMILIES.index(row["family"])], pair, row["G_W_K"], nodes)
    flow = table["flow"]
    path_nodes = [nodes.index(name) for name in flow["path"]]
    for before, after in zip([path_nodes[-1], *path_nodes], path_nodes, strict=False):
        films[0, after, after] += flow["rate_W_K"]
        films[0, after, before] -= flow["rate_W_K"]

    laws, heat_to = [], np.zeros((n, len(table["heat"])))
    for s, (name, row) in enumerate(table["heat"].items()):
        heat_to[:, s] = _weights(row["to"], nodes, f"heat.{name}")
        if abs(heat_to[:, s].sum() - 1) > 1e-9:
            raise ValueError(f"heat.{name}: the shares in `to` must sum to 1")
        numbers = {key: float(row.get(key, 0)) for key in ("standby", "linear", "power", "viscous_per_K")}
        laws.append(HeatLaw(drive=row["drive"], at=row["at"], exponent=row["exponent"], **numbers))

    places = nodes + ZONES
    sensors = table["sensor"]
    growth, elastic = table["growth"], table["elastic"]
    alpha = elastic["alpha_1_K"]
    nine = np.zeros((len(THERMAL_ERRORS), n))
    for term in elastic["terms"]:
        row = _weights(term["at"], nodes, f"elastic term of {term['error']}")
        nine[THERMAL_ERRORS.index(term["error"])] += alpha * _factor(term) * row
    return Parameters(
        nodes=nodes,
        capacity=np.array([row["mass_kg"] * row["c_J_kgK"] for row in table["node"].values()]),
        conductance=conductance,
        outside=outside,
        films=films,
        laws=tuple(laws),
        heat_to=heat_to,
        channels=tuple(sensors),
        sensor_at=np.array([_weights(row["at"], places, f"sensor.{name}") for name, row in sensors.items()]),
        lag_s=np.array([float(row["lag_s"]) for row in sensors.values()]),
        growth=alpha
        * growth["length_mm"]
        * 1e3
        * (_weights(growth["plus"], nodes, "growth.plus") - _weights(growth["minus"], nodes, "growth.minus")),
        elastic=nine,
        flow_rate_W_K=flow["rate_W_K"],
        chiller_set_degC=flow["chiller_set_degC"],
        chiller_gain_W_K=flow["chiller_gain_W_K"],
        chiller_max_W=flow["chiller_max_W"],
    )
