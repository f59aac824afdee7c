"""The machine as a whole: what it does in, temperatures, sensors, spindle growth and thermal errors out."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from simulators.lumped.environment import Environment
from simulators.lumped.network import Array, Network
from simulators.lumped.parameters import (
    BOUNDARIES,
    ERROR_ROWS,
    LINKS,
    NODES,
    ROOT_GROWTH_UM,
    SPINDLE_GROWTH_ROW,
)
from simulators.lumped.sensors import SENSORS, SensorModel
from talc.names import THERMAL_ERRORS

STEP_S = 30.0
"""Inner step. Results do not depend on how a caller cuts the time."""
_CHILLER_SET = 22.0
_SETTLING_S = 3 * 86400.0
_GROWTH_NOISE_UM = 0.2


@dataclass(frozen=True, slots=True)
class Drive:
    """What heats the machine over one inner step: mean magnitudes."""

    x: float = 0.0
    """mm/min; likewise y and z."""
    y: float = 0.0
    z: float = 0.0
    a: float = 0.0
    """1/min; likewise c and spindle."""
    c: float = 0.0
    spindle: float = 0.0
    cutting_fluid: float = 0.0
    """0 off to 1 on."""


def heat_of(drive: Drive) -> dict[str, float]:
    """Watts per node. Friction of nuts and guides goes with the speed, of bearings with its power 1.5 (churning)."""
    x, y, z = (140.0 * v / 10_000.0 for v in (drive.x, drive.y, drive.z))  # 140 W at 10 m/min
    a = 20.0 * (drive.a > 0) + 110.0 * drive.a / 15.0  # holding current, then up to 130 W at 15 1/min
    c = 900.0 * (drive.c / 120.0) ** 1.5  # direct drive, 900 W at 120 1/min
    spindle = 700.0 * (drive.spindle / 18_000.0) ** 1.5 + 60.0 * (drive.spindle > 0)
    return {
        "x_nut": 0.45 * x, "x_screw": 0.4 * x, "x_slide": 0.15 * x,
        "y_nut": 0.6 * y, "y_slide": 0.4 * y,
        "z_nut": 0.6 * z, "z_slide": 0.4 * z,
        "a_drive": a,
        "c_drive": 0.8 * c, "c_bearing": 0.2 * c,
        "spindle_motor": 0.62 * spindle, "spindle_front": 0.16 * spindle, "spindle_rear": 0.08 * spindle,
        "spindle_shaft": 0.14 * spindle,
        "tank": 350.0 * drive.cutting_fluid,  # the pump
        "coolant": 40.0,
    }  # fmt: skip


class MachinePlant:
    """Steps on an inner grid of 30 s; between its points results are interpolated.

    Parameters
    ----------
    seed: of weather, door and sensor noise; the noise of a value depends on seed, sensor and time alone
    drive: mean drive over a stretch (begin, end) of time that is over
    sphere_radius_m: radius at which ER0T is defined; radial growth is proportional to the radius
    start_hour: hour of the day at 0 s
    """

    def __init__(
        self, seed: int, drive: Callable[[float, float], Drive], sphere_radius_m: float, *, start_hour: float = 6.0
    ) -> None:
        self._network = Network(NODES, LINKS, BOUNDARIES)
        self._environment = Environment(seed, start_hour)
        self._drive = drive
        self._seed, self._sphere_radius = seed, sphere_radius_m
        self._errors = self._rows([ERROR_ROWS[name] for name in THERMAL_ERRORS])
        self._growth = self._rows([SPINDLE_GROWTH_ROW])[0]
        self._sensors = SensorModel(seed)
        self._temperatures = self._settled()
        self._start = self._temperatures.copy()
        self._sensors.settle(self._seen(0.0))
        self._time = 0.0
        self._spindle = 0.0
        self._history: list[tuple[float, Array]] = [(0.0, np.zeros(len(THERMAL_ERRORS)))]

    def advance(self, time_s: float) -> None:
        """Bring the plant to the last inner step at or before `time_s`; earlier times change nothing."""
        while self._time + STEP_S <= time_s:
            end = self._time + STEP_S
            drive = self._drive(self._time, end)
            self._temperatures = self._network.step(
                self._temperatures, STEP_S, self._heat(drive), self._flows(drive), self._boundary(end)
            )
            self._time, self._spindle = end, drive.spindle
            self._sensors.step(STEP_S, self._seen(end))
            self._history.append((end, self._errors @ (self._temperatures - self._start)))
            del self._history[:-600]

    def sensors(self) -> dict[str, float]:
        """The 29 temperatures as their sensors see them, degC, before a device quantises them."""
        return self._sensors.values(round(self._time / STEP_S))

    def spindle_growth_um(self) -> float:
        """Elongation at the spindle nose since 0 s, µm, with the sensor's noise of 0.2 µm."""
        noise = np.random.default_rng([self._seed, 3, round(self._time / STEP_S)]).normal(0.0, _GROWTH_NOISE_UM)
        centrifugal = ROOT_GROWTH_UM * (self._spindle / 18_000.0) ** 2
        return float(self._growth @ (self._temperatures - self._start) + centrifugal + noise)

    def errors(self, time_s: float | None = None) -> Array:
        """(9,) thermal errors since 0 s, µm and µm/m; the last five hours are remembered."""
        if time_s is None or time_s >= self._time:
            return self._history[-1][1]
        first = self._history[0][0]
        position = max(0.0, (time_s - first) / STEP_S)
        i = int(position)
        low, high = self._history[i][1], self._history[min(i + 1, len(self._history) - 1)][1]
        return np.asarray(low + (high - low) * (position - i), dtype=np.float64)

    def tool_deviation_um(
        self,
        time_s: float,
        x_mm: float,
        y_mm: float,
        z_mm: float,
        a_deg: float,
        c_deg: float,  # noqa: ARG002
    ) -> tuple[float, float, float]:
        """Where the workpiece point that nominally meets the tool tip really is, X Y Z, µm.

        By homogeneous transforms with finite rotations, independent of the linearised equations of the gateway. C is
        not needed: the machine is round about it, and the point is given where C has turned it.
        """
        self.advance(time_s)
        ey0a, ez0a, ex0c, ey0c, ez0t, er0t, ea0c, eb0c, ec0c = (float(v) * 1e-6 for v in self.errors(time_s))
        a = math.radians(a_deg)
        turn_a = _about_x(a)
        nominal = np.array([x_mm, y_mm, z_mm]) * 1e-3
        in_cradle = turn_a.T @ nominal  # where the point is, seen from the cradle; C has turned it there
        outward = np.array([in_cradle[0], in_cradle[1], 0.0]) / self._sphere_radius
        tilted = _about_z(ec0c) @ _about_y(eb0c) @ _about_x(ea0c) @ in_cradle
        grown = tilted + er0t * outward + np.array([ex0c, ey0c, ez0t])
        real = turn_a @ grown + np.array([0.0, ey0a, ez0a])
        x, y, z = (float(v) * 1e6 for v in real - nominal)
        return x, y, z

    def _rows(self, rows: list[dict[str, float]]) -> Array:
        matrix = np.zeros((len(rows), len(NODES)))
        for i, row in enumerate(rows):
            for name, coefficient in row.items():
                matrix[i, self._network.index(name)] += coefficient
        return matrix

    def _heat(self, drive: Drive) -> Array:
        heat = np.zeros(len(NODES))
        for name, watts in heat_of(drive).items():
            heat[self._network.index(name)] += watts
        return heat

    def _flows(self, drive: Drive) -> dict[str, float]:
        stirring = min(1.0, drive.c / 60.0 + drive.x / 10_000.0)
        return {"cutting_fluid": drive.cutting_fluid, "stirring": stirring}

    def _boundary(self, time_s: float) -> Array:
        hall = self._environment.at(time_s)
        hysteresis = 0.8 * math.sin(2 * math.pi * time_s / 1140.0)  # the chiller cycles, period 19 min
        return np.array([hall.low, hall.high, _CHILLER_SET + hysteresis])

    def _settled(self) -> Array:
        """Temperatures after three days at standstill: the machine as it is found on Monday morning."""
        boundary = self._boundary(0.0)
        t = self._network.steady_state(self._heat(Drive()), self._flows(Drive()), boundary)
        for back in np.arange(-_SETTLING_S, 0.0, 300.0):
            hour_shift = self._boundary(float(back % 86400.0))
            t = self._network.step(t, 300.0, self._heat(Drive()), self._flows(Drive()), hour_shift)
        return t

    def _seen(self, time_s: float) -> dict[str, float]:
        """Temperature at the place of each sensor, degC."""
        node = dict(zip(self._network.names, (float(v) for v in self._temperatures), strict=True))
        hall = self._environment.at(time_s)
        middle = (hall.low + hall.high) / 2
        places = {
            "ambient_front": hall.low, "ambient_rear": middle, "ambient_left": middle - 0.2, "ambient_high": hall.high,
            "space_left": node["space"], "space_right": 0.8 * node["space"] + 0.2 * node["tank"],
            "coolant_in": 0.15 * node["coolant"] + 0.85 * float(self._boundary(time_s)[2]),
            "coolant_out": node["coolant"], "cutting_fluid": node["tank"],
        }  # fmt: skip
        return {name: places.get(name, node.get(name, math.nan)) for name in SENSORS}


def _about_x(angle: float) -> Array:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def _about_y(angle: float) -> Array:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def _about_z(angle: float) -> Array:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
