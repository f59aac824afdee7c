"""Records of simulated machines: sensors in 0.1 K steps, errors with the noise of the six-pose probing cycle."""

from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace

import numpy as np

from simulators.cases import SEASONS, random_axes
from simulators.nc import LoadCase
from simulators.plant import (
    MACHINES,
    MachineDrive,
    Plant,
    PlantParameters,
    assemble_machine,
    load_machine,
    machine_tables,
    record_drive,
    reduced,
)
from studies import Days, days

_IDLE_S = 12 * 3600.0
_REFERENCE_CYCLES = 5
"""The gateway's reference is the mean of this many measurements; its noise is part of all later measurements."""


def varied(seed: int) -> PlantParameters:
    """One machine of the kind. Seeds 0-3 give the plant and its variants as they are. Later seeds give the same in
    turn, with conduction, films, masses, losses, expansion and lags scattered by 20-35 % (lognormal)."""
    name = MACHINES[seed % len(MACHINES)]
    if seed < len(MACHINES):
        return load_machine(name)
    chosen, draw = machine_tables(name), np.random.default_rng([seed, 77])
    table = deepcopy(chosen.machine)
    for section, keys, sigma in (
        ("node", ("mass_kg",), 0.25),
        ("conduction", ("G_W_K",), 0.35),
        ("air", ("h_W_m2K",), 0.35),
        ("film", ("G_W_K", "h_W_m2K"), 0.35),
        ("heat", ("linear", "power"), 0.3),
        ("sensor", ("lag_s",), 0.3),
        ("expansion", ("alpha",), 0.2),
    ):
        for row in table[section].values():
            for key in keys:
                if key in row:
                    row[key] *= _scatter(draw, sigma)
    bodies = {
        body: replace(model, C=model.C * _scatter(draw, 0.25), K=model.K * _scatter(draw, 0.35))
        for body, model in reduced(chosen.reduced).items()
    }
    return assemble_machine(table, bodies)


def _scatter(draw: np.random.Generator, sigma: float) -> float:
    return float(np.exp(draw.normal(0, sigma)))


def machine_days(
    kind: str, seed: int, hours: int, *, noise_seed: int | None = None, off: Callable[[int], bool] | None = None
) -> Days:
    """`day`: a shop's day of operations (simulators.nc.LoadCase); `axes`: Z22's random loads. The seed determines
    machine, loads, weather and noise; noise_seed: other sensor and probing noise on the same physics; off: the rows in
    which the machine is switched off."""
    noise = seed if noise_seed is None else noise_seed
    season = ("spring", "winter", "summer")[seed % 3]
    plant = Plant(varied(seed), SEASONS[season], seed + 1000)
    plant.advance(_IDLE_S, MachineDrive())
    plant.zero()
    steps = hours * 12
    drives = random_axes(seed, steps) if kind == "axes" else _day(seed, steps)
    if off is not None:
        drives = [MachineDrive(powered=False) if off(k) else drive for k, drive in enumerate(drives)]
    series = record_drive(plant, drives)
    inputs = series.inputs
    if noise_seed is not None:
        draw = np.random.default_rng([noise, 9])
        inputs = inputs + np.concatenate([np.full(29, 0.05), [0.2], np.zeros(6)]) * draw.normal(size=inputs.shape)
    probed = days(replace(series, inputs=inputs), noise)
    reference = np.random.default_rng([noise, 13]).normal(0.0, probed.sigma / np.sqrt(_REFERENCE_CYCLES))
    return replace(probed, measured=probed.measured - reference)


def _day(seed: int, steps: int) -> list[MachineDrive]:
    case = LoadCase.random(seed, (steps + 300) * 300.0, start_hour=6.0)
    drives = []
    for k in range(steps):
        mean = np.asarray(case.integral((k + 1) * 300.0)) - np.asarray(case.integral(k * 300.0))
        x, y, z, a, c, spindle, coolant = (float(v) for v in mean / 300.0)
        drives.append(
            MachineDrive(
                speed_x=x, speed_y=y, speed_z=z, speed_a=a, speed_c=c, spindle_speed=spindle, coolant_on=coolant >= 0.5
            )
        )
    return drives
