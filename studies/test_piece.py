"""A test piece milled hour by hour on a machine that warms up and cools down, as in B19 section 4.

A day of calibration under changing loads, a night of rest, then 4 h of the C axis at 1200 1/min and 4 h of rest; each
hour a set of features is milled. A feature's deviation is that of the tool against the workpiece when it is milled,
relative to the first set. The same with the other axes (ISO 230-3's tests), machines, and failing sensors.
"""

from collections.abc import Mapping, Sequence
from typing import Any, get_args

import numpy as np

from simulators.cases import SEASONS, Axis, table_and_fluid, warm_up_and_cool_down
from simulators.plant import MACHINES, Failure, FailureKind, MachineDrive, Plant, load_machine, record_drive
from studies.frame import RunParameters, Study
from studies.loop import RADIUS_M, Days, control, days, filled, held, regressed
from studies.test_piece_report import METHODS, report
from talc.frame import FloatArray
from talc.kinematics import tcp_offsets, workpiece_growth
from talc.settings import TalcSettings

REPETITIONS, OTHER_REPETITIONS = 20, 4
"""Repetitions of the test itself, and of each variation."""
STEP_S = 300.0
HOUR = 12
"""Steps."""
CALIBRATION_H, REST_H, WARM_H, COOL_H = 24, 12, 4, 4
IDLE_H = 12
"""Hours for which the machine is on before its calibration begins."""
SETS = WARM_H + COOL_H + 1

FEATURES: dict[str, tuple[tuple[float, float, float], float, float, tuple[float, float, float]]] = {
    "top face, Z": ((0.0, 0.0, 80.0), 0.0, 0.0, (0.0, 0.0, 1.0)),
    "right face, X": ((90.0, 0.0, 40.0), 0.0, 0.0, (1.0, 0.0, 0.0)),
    "left face, X (C 180°)": ((90.0, 0.0, 40.0), 0.0, 180.0, (1.0, 0.0, 0.0)),
    "rear face, Y": ((0.0, 90.0, 40.0), 0.0, 0.0, (0.0, 1.0, 0.0)),
    "side face, Z (A -90°)": ((0.0, 40.0, 90.0), -90.0, 0.0, (0.0, 0.0, 1.0)),
    "bore, Y (A -90°)": ((0.0, 40.0, 90.0), -90.0, 0.0, (0.0, 1.0, 0.0)),
}
"""Tool tip X Y Z in mm from where A and C meet, A and C in degrees, and the direction that the feature shows."""

EXPANSION_PER_K = 23.1e-6
"""Aluminium."""
HELD_MM = np.zeros(3)
"""The workpiece is held in the table's middle, at the height where A and C meet."""
TO_TABLE_S, TO_AIR_S = 1800.0, 7200.0
"""Time constants of the workpiece's mean temperature towards table and working space (choice)."""


def runs(seed: int, small: bool) -> list[RunParameters]:
    """Each repetition has its own weather, calibration loads and noise.

    Beside B19's test on the base machine: on its variants, with another axis warmed up, and with failing sensors.
    """
    base = {"machine": "base", "axis": "speed_c", "failing": False}
    others = [{**base, "machine": machine} for machine in MACHINES[1:]]
    others += [{**base, "axis": axis} for axis in get_args(Axis) if axis != "speed_c"]
    others.append({**base, "failing": True})
    if small:
        others = [{**base, "failing": True}]
    return [
        {"seed": seed, "repetition": r, **where}
        for where, count in ((base, REPETITIONS), *((other, OTHER_REPETITIONS) for other in others))
        for r in range(1 if small else count)
    ]


def failures(channels: Sequence[str], seed: int) -> list[Failure]:
    """Three temperature channels, one of each kind, each from a random time after the calibration until the end."""
    draw = np.random.default_rng([seed, 13])
    begin, end = IDLE_H + CALIBRATION_H, IDLE_H + CALIBRATION_H + REST_H + WARM_H + COOL_H
    return [
        Failure(channel=channels[int(c)], kind=kind, from_s=float(draw.uniform(begin, end)) * 3600.0)
        for c, kind in zip(draw.choice(len(channels), len(FailureKind), replace=False), FailureKind, strict=True)
    ]


def run(parameters: RunParameters) -> Mapping[str, Any]:
    """By method, without and with the workpiece's growth: (sets, features) µm relative to the first set."""
    seed = 1000 * parameters["seed"] + parameters["repetition"]
    rest, machine = MachineDrive(), load_machine(parameters["machine"])
    test = warm_up_and_cool_down(parameters["axis"], share=1.0, warm_h=WARM_H, cool_h=COOL_H, step_s=STEP_S)
    case = table_and_fluid("C", seed, hours=CALIBRATION_H, step_s=STEP_S).drives
    drives = [*case, *[rest] * (REST_H * HOUR), *test]

    def observed(failing: Sequence[Failure]) -> Days:
        plant = Plant(machine, SEASONS["spring"], seed, failures=failing)
        plant.advance(IDLE_H * 3600.0, rest)
        plant.zero()
        return days(record_drive(plant, drives, STEP_S), seed)

    whole = observed(())
    series = observed(failures(machine.channels, seed)) if parameters["failing"] else whole
    course = control(series, TalcSettings(method="models"))
    learnt = control(series, TalcSettings(method="learner"), measured=course.used)
    first = (CALIBRATION_H + REST_H) * HOUR - 1
    sets = first + HOUR * np.arange(SETS)
    estimates = {
        "none": np.zeros_like(series.truth),
        "hold": held(series, course.used),
        "regression": regressed(series, course.used),
        "TALC": course.estimate,
        "learner": learnt.estimate,
    }
    table, air = series.names.index("c_table"), [series.names.index(n) for n in ("space_left", "space_right")]
    # Failing sensors do not affect the workpiece; they affect the growth term.
    piece = workpiece(whole.inputs[:, table], whole.inputs[:, air].mean(axis=1))
    assumed = filled(series.inputs)[:, table]
    result: dict[str, Any] = {
        "features": list(FEATURES),
        "measurements": int(course.used[first:].sum()),
        "workpiece_K": float(np.ptp(piece[sets])),
    }
    for method in METHODS:
        left = np.array([deviations(series.truth[k] - estimates[method][k]) for k in sets])
        for term in (False, True):
            # Without the term the workpiece is assumed to stay as warm as it was.
            believed = assumed if term else np.full(len(assumed), assumed[first])
            grown = np.array([growth(piece[k] - piece[first]) - growth(believed[k] - assumed[first]) for k in sets])
            seen = left + grown
            result[f"{method} + growth" if term else method] = (seen - seen[0]).tolist()
    return result


def workpiece(table_degC: FloatArray, air_degC: FloatArray) -> FloatArray:
    """(T,) degC: the workpiece's mean temperature, which follows table and air; in the first row it has settled."""
    to_table, to_air = STEP_S / TO_TABLE_S, STEP_S / TO_AIR_S
    rate = to_table + to_air
    keep = np.exp(-rate)
    drive = (to_table * table_degC + to_air * air_degC) / rate
    piece = np.empty(len(drive))
    now = float(drive[0])
    for k, towards in enumerate(drive.tolist()):
        now = keep * now + (1.0 - keep) * towards
        piece[k] = now
    return piece


def deviations(errors: FloatArray) -> FloatArray:
    """(features,) µm by which the workpiece point is away from the tool, in each feature's direction."""
    found = []
    for point, a, c, direction in FEATURES.values():
        position = np.array([*point, np.deg2rad(a), np.deg2rad(c)])
        found.append(float(np.array(direction) @ tcp_offsets(errors, position, RADIUS_M)))
    return np.array(found)


def growth(warmer_K: float) -> FloatArray:
    """(features,) µm by which a feature of a warmer workpiece shrinks when the workpiece cools."""
    found = []
    for point, _, _, direction in FEATURES.values():
        shift = workpiece_growth(
            np.array(point), HELD_MM, expansion_per_K=EXPANSION_PER_K, temperature_degC=warmer_K, reference_degC=0.0
        )
        found.append(float(np.array(direction) @ shift))
    return np.array(found)


STUDY = Study("test-piece", "A test piece milled hour by hour while the machine warms and cools", runs, run, report)
