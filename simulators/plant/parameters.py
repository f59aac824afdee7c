"""The machine as matrices: reduced bodies (`reduced/*.json`) joined by the table `machine.toml`, or a variant of it."""

import json
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from simulators.plant.body import BodyModel, Face, FloatArray
from simulators.plant.joined import ZONES, join
from simulators.plant.shape import merge

HERE = Path(__file__).parent
VARIANTS: dict[str, Any] = tomllib.loads((HERE / "variants.toml").read_text(encoding="utf-8"))
MACHINES = ("base", *VARIANTS)


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
class PlantParameters:
    """One machine. n coordinates (reduced bodies, then lumped nodes), z zones, f films, s heat sources, c channels."""

    places: Mapping[str, FloatArray]
    """(n,) rows that give the mean temperature of a patch or of a lumped node"""
    capacity: FloatArray
    """(n,) J/K of a node; 1 for a body's coordinate, whose unit is chosen so"""
    conductance: FloatArray
    """(n, n) W/K, symmetric"""
    outside: FloatArray
    """(n, z) W/K"""
    films: FloatArray
    """(f, n, n) W/K at factor 1, in the order of FAMILIES; all but `flow` symmetric"""
    laws: tuple[HeatLaw, ...]
    heat_to: FloatArray
    """(n, s) effect of 1 W of each source; transposed, the temperature that affects the source"""
    channels: tuple[str, ...]
    sensor_at: FloatArray
    """(c, n + z) weights"""
    lag_s: FloatArray
    """(c,)"""
    growth: FloatArray
    """(n,) µm/K at the eddy-current sensor"""
    elastic: FloatArray
    """(9, n) µm/K, µm/m/K for the last three"""
    even: FloatArray
    """(n,) the coordinates of 1 K everywhere"""
    flow_rate_W_K: float  # noqa: N815
    chiller_set_degC: float  # noqa: N815
    chiller_gain_W_K: float  # noqa: N815
    chiller_max_W: float  # noqa: N815


@dataclass(frozen=True, slots=True)
class Tables:
    """The data from which a machine is made."""

    machine: dict[str, Any]
    """machine.toml with the variant's changes"""
    shape: dict[str, Any]
    """changes to shape.toml"""
    reduced: str
    """name of the reduced bodies"""


def machine_tables(name: str = "base") -> Tables:
    """The tables of "base" or of a variant in variants.toml. ValueError: another name."""
    if name not in MACHINES:
        raise ValueError(f"machine {name!r}: expected one of {', '.join(MACHINES)}")
    change = VARIANTS.get(name, {})
    machine = merge(tomllib.loads((HERE / "machine.toml").read_text(encoding="utf-8")), change.get("machine", {}))
    shape = change.get("shape", {})
    return Tables(machine, shape, name if name == "base" or shape else "base")


def load_machine(name: str = "base") -> PlantParameters:
    """A machine by name: "base", or a variant of variants.toml. ValueError names an invalid name or entry."""
    chosen = machine_tables(name)
    return assemble_machine(chosen.machine, reduced(chosen.reduced))


def reduced(name: str) -> dict[str, BodyModel]:
    """The committed bodies, made by `python -m simulators.plant.generate`."""
    return read_bodies(HERE / "reduced" / f"{name}.json")


def read_bodies(path: Path) -> dict[str, BodyModel]:
    """The bodies of a file that `python -m simulators.plant.generate` has written, by name."""
    stored = json.loads(path.read_text(encoding="utf-8"))
    bodies = {}
    for body, row in stored.items():
        n = len(row["even"])
        bodies[body] = BodyModel(
            C=np.eye(n),
            K=_symmetric(row["K"], n),
            faces={
                patch: Face(_symmetric(f["H"], n), np.array(f["g"]), f["area"]) for patch, f in row["faces"].items()
            },
            points={point: np.array(values) for point, values in row["points"].items()},
            even=np.array(row["even"]),
            elastic=np.array(row["elastic"]),
        )
    return bodies


def assemble_machine(table: Mapping[str, Any], bodies: Mapping[str, BodyModel]) -> PlantParameters:
    """A table's machine over reduced bodies. ValueError names an invalid entry."""
    joined, flow = join(table, bodies), table["flow"]
    laws = []
    for row in table["heat"].values():
        numbers = {key: float(row.get(key, 0)) for key in ("standby", "linear", "power", "viscous_per_K")}
        laws.append(HeatLaw(drive=row["drive"], at=row["at"], exponent=row["exponent"], **numbers))
    sensors = table["sensor"]
    felt = np.zeros((len(sensors), joined.even.size + len(ZONES)))
    for row, (channel, sensor) in zip(felt, sensors.items(), strict=True):
        for place, weight in sensor["at"].items():
            if place in ZONES:
                row[joined.even.size + ZONES.index(place)] += weight
            elif place in joined.points:
                row[: joined.even.size] += weight * joined.points[place]
            elif place in table["node"]:
                row[: joined.even.size] += weight * joined.places[place]
            else:
                raise ValueError(f"sensor.{channel}: no point, node or zone {place!r}")
    return PlantParameters(
        places=joined.places,
        capacity=np.diag(joined.C).copy(),
        conductance=joined.K,
        outside=joined.outside,
        films=np.array(joined.films),
        laws=tuple(laws),
        heat_to=joined.heat_to,
        channels=tuple(sensors),
        sensor_at=felt,
        lag_s=np.array([float(row["lag_s"]) for row in sensors.values()]),
        growth=joined.growth,
        elastic=joined.elastic,
        even=joined.even,
        flow_rate_W_K=flow["rate_W_K"],
        chiller_set_degC=flow["chiller_set_degC"],
        chiller_gain_W_K=flow["chiller_gain_W_K"],
        chiller_max_W=flow["chiller_max_W"],
    )


def _symmetric(lower: list[float], n: int) -> FloatArray:
    dense = np.zeros((n, n))
    dense[np.tril_indices(n)] = lower
    return dense + np.tril(dense, -1).T
