"""The machine in its hall: stepped by time, read like an instrument."""

import math
from collections.abc import Sequence
from datetime import UTC, datetime

import numpy as np

from simulators.plant.ageing import Ageing, Drift, Failure, FailureKind
from simulators.plant.body import FloatArray
from simulators.plant.drive import HeatLoads, MachineDrive, loads
from simulators.plant.environment import Environment, Hall
from simulators.plant.network import Network
from simulators.plant.parameters import PlantParameters

STEP_S = 30.0
RADIUS_MM = 200.0
"""Radius to which ER0T refers: the sphere's distance from the C axis."""
_REST_S = 72 * 3600.0
_REST_STEP_S = 600.0
_NOISE_BLOCK = 256
_DRIFT_STEP_S = 600.0
_MONDAY = datetime(2026, 3, 2, 6, 0, tzinfo=UTC)


class Plant:
    """Advances on a fixed grid of 30 s, whatever the caller's steps; between grid points values are constant.

    Heat and films are averaged over a grid step, so polling changes neither physics nor any random draw. Before
    `start_utc` the machine stood 72 h switched off in the same hall; errors are relative to the start.
    """

    def __init__(
        self,
        parameters: PlantParameters,
        environment: Environment,
        seed: int,
        *,
        start_utc: datetime = _MONDAY,
        ageing: Ageing | None = None,
        failures: Sequence[Failure] = (),
    ) -> None:
        self.parameters, self._seed = parameters, seed
        for failure in failures:
            if failure.channel not in parameters.channels:
                raise ValueError(f"failures: no channel {failure.channel!r}")
        self._failures = tuple(failures)
        self._stuck: dict[Failure, float] = {}
        self._drift = Drift(ageing or Ageing(), seed, len(parameters.laws), len(parameters.channels))
        self._network = Network(parameters)
        self._hall = Hall(environment, seed, start_utc.astimezone(UTC), _REST_S)
        self._viscous = np.array([law.viscous_per_K for law in parameters.laws])
        self._tank = parameters.places["coolant_tank"]
        self._ease = 1 - np.exp(-STEP_S / parameters.lag_s)
        count = len(parameters.channels)
        self._offset = np.random.default_rng([seed, 3]).normal(0.0, 0.1, count)
        self._noise: tuple[int, FloatArray] = (-1, np.empty((0, count + 1)))
        self._loads: dict[MachineDrive, HeatLoads] = {}
        self._open: list[tuple[float, HeatLoads]] = []
        self._index, self._time_s = 0, 0.0
        self._grip = math.nan, np.ones(len(parameters.laws))
        self._rest()
        self._note_stuck()
        self._start = self.state.copy()

    def _rest(self) -> None:
        off = self._of(MachineDrive(powered=False))
        self.state = self._network.steady(off.films, self.parameters.heat_to @ off.heat_W, self._hall.zones(-_REST_S))
        for k in range(int(_REST_S / _REST_STEP_S)):
            self._step(off, -_REST_S + k * _REST_STEP_S, _REST_STEP_S)
        self._felt = self.parameters.sensor_at @ np.concatenate([self.state, self._air])

    @property
    def time_s(self) -> float:
        """Seconds since the start to which the plant has advanced."""
        return self._time_s

    def advance(self, time_s: float, drive: MachineDrive) -> None:
        """Apply `drive` from the present time until time_s. A time in the past changes nothing."""
        now = self._of(drive)
        while self._time_s < time_s:
            end = (self._index + 1) * STEP_S
            until = min(end, time_s)
            self._open.append((until - self._time_s, now))
            self._time_s = until
            if until >= end:
                self._step(self._mean(), self._index * STEP_S, STEP_S)
                self._index += 1
                self._open.clear()
                true = self.parameters.sensor_at @ np.concatenate([self.state, self._air])
                self._felt = self._felt + self._ease * (true - self._felt)
                self._note_stuck()

    def zero(self, like: "Plant | None" = None) -> None:
        """Set the reference of errors and spindle growth to the present state, as after a reference measurement.

        like: take that of another plant of the same machine, as in another season. ValueError: another machine.
        """
        if like is not None and like.parameters is not self.parameters:
            raise ValueError("like: expected a plant of the same parameters")
        self._start = (self.state if like is None else like._start).copy()  # noqa: SLF001 - of this class

    def sensors(self) -> dict[str, float]:
        """degC by channel: lagged, with offset (0.1 K and its drift) and noise (0.05 K); not quantised. NaN: open."""
        drifted = self._offset + self._drift.offsets(self._index * STEP_S)
        values = self._felt + drifted + 0.05 * self._noise_now()[:-1]
        read = dict(zip(self.parameters.channels, values.tolist(), strict=True))
        for failure in self._failures:
            if failure.from_s <= self._time_s < failure.until_s:
                read[failure.channel] = self._spoilt(failure, read[failure.channel])
        return read

    def temperature(self, place: str) -> float:
        """degC, mean over a patch ("table.top") or of a lumped node ("coolant_tank"); true, without lag."""
        return float(self.parameters.places[place] @ self.state)

    def spindle_growth_um(self) -> float:
        """Nose against housing since the start, µm, with 0.2 µm of noise."""
        return float(self.parameters.growth @ (self.state - self._start) + 0.2 * self._noise_now()[-1])

    def errors(self) -> FloatArray:
        """(9,) true errors since the start in the order of THERMAL_ERRORS; µm, µm/m for the last three."""
        nine: FloatArray = self.parameters.elastic @ (self.state - self._start)
        return nine

    def deviation_um(self, x_mm: float, y_mm: float, z_mm: float, a_deg: float, c_deg: float) -> FloatArray:
        """(3,) µm by which the workpiece point that should be at (x, y, z) is away from it.

        The origin is where A and C meet. Homogeneous transforms T_A Rx(a) T_C with small errors are compared with
        Rx(a); the table's growth acts along C and, in proportion to the radius, outwards. `c_deg` has no effect: the
        nine errors come before C in the chain, and the table grows equally in all directions.
        """
        del c_deg
        ey0a, ez0a, ex0c, ey0c, ez0t, er0t, ea0c, eb0c, ec0c = self.errors() * 1e-6
        a = math.radians(a_deg)
        turn = np.eye(4)
        turn[1:3, 1:3] = [[math.cos(a), -math.sin(a)], [math.sin(a), math.cos(a)]]
        at_a, at_c = np.eye(4), np.eye(4)
        at_a[:3, 3] = 0.0, ey0a, ez0a
        at_c[:3] = [[1, -ec0c, eb0c, ex0c], [ec0c, 1, -ea0c, ey0c], [-eb0c, ea0c, 1, 0.0]]
        nominal = np.array([x_mm, y_mm, z_mm, 1e3]) * 1e-3
        on_table = turn.T @ nominal
        grown = on_table + np.array([*(on_table[:2] * er0t / (RADIUS_MM * 1e-3)), ez0t, 0.0])
        moved: FloatArray = (at_a @ turn @ at_c @ grown - nominal)[:3] * 1e6
        return moved

    def _of(self, drive: MachineDrive) -> HeatLoads:
        if drive not in self._loads:
            if len(self._loads) > 1000:
                self._loads.clear()
            self._loads[drive] = loads(self.parameters, drive)
        return self._loads[drive]

    def _mean(self) -> HeatLoads:
        first = self._open[0][1]
        if all(part is first for _, part in self._open):
            return first
        share = [duration / STEP_S for duration, _ in self._open]
        parts = [part for _, part in self._open]
        return HeatLoads(
            np.sum([w * p.heat_W for w, p in zip(share, parts, strict=True)], axis=0),
            np.sum([w * p.films for w, p in zip(share, parts, strict=True)], axis=0),
            sum(w * p.chiller for w, p in zip(share, parts, strict=True)),
        )

    def _step(self, load: HeatLoads, time_s: float, dt_s: float) -> None:
        p = self.parameters
        warmth = p.heat_to.T @ self.state - 20.0
        if (now := time_s // _DRIFT_STEP_S) != self._grip[0]:
            self._grip = now, np.where(self._viscous > 0, self._drift.friction(now * _DRIFT_STEP_S), 1.0)
        heat = p.heat_to @ (load.heat_W * self._grip[1] * np.exp(-self._viscous * warmth))
        wanted = p.chiller_gain_W_K * (float(self._tank @ self.state) - p.chiller_set_degC)
        heat -= load.chiller * min(max(wanted, 0.0), p.chiller_max_W) * self._tank
        self._air = self._hall.zones(time_s + dt_s / 2)
        self.state = self._network.step(self.state, load.films, heat, self._air, dt_s)

    def _note_stuck(self) -> None:
        """Note the reading of a sensor that is stuck from now on. Noted here and not on reading, so that polling has no
        effect."""
        for failure in self._failures:
            if (
                failure.kind is FailureKind.STUCK
                and failure not in self._stuck
                and failure.from_s <= self._index * STEP_S
            ):
                c = self.parameters.channels.index(failure.channel)
                self._stuck[failure] = float(self._felt[c] + self._offset[c])

    def _spoilt(self, failure: Failure, value: float) -> float:
        match failure.kind:
            case FailureKind.OPEN:
                return math.nan
            case FailureKind.STUCK:
                return self._stuck.get(failure, value)
            case FailureKind.OFFSET:
                return value + failure.by_K

    def _noise_now(self) -> FloatArray:
        block, row = divmod(self._index, _NOISE_BLOCK)
        if self._noise[0] != block:
            generator = np.random.default_rng([self._seed, 4, block])
            self._noise = block, generator.standard_normal((_NOISE_BLOCK, len(self.parameters.channels) + 1))
        line: FloatArray = self._noise[1][row]
        return line
