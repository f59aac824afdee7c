"""The detailed plant against closed forms, balances and magnitudes."""

import math
from dataclasses import replace

import numpy as np
import pytest

from simulators.plant import Environment, MachineDrive, Parameters, Plant, load, record
from simulators.plant.drive import loads
from simulators.plant.network import Network
from simulators.plant.parameters import FAMILIES, ZONES
from talc.names import THERMAL_ERRORS

CALM = Environment(daily_amplitude_K=0, weather_sigma_K=0, gradient_K_m=0, door_openings_per_day=0)


@pytest.fixture(scope="module")
def machine() -> Parameters:
    return load()


def test_names_are_those_of_the_bench(machine: Parameters) -> None:
    assert len(machine.channels) == 29
    assert {"bed_front_left", "spindle_motor", "ambient_high", "space_right", "cutting_fluid"} <= set(machine.channels)
    assert np.allclose(machine.sensor_at.sum(axis=1), 1.0)


def test_without_sources_and_hall_differences_vanish_and_heat_stays(machine: Parameters) -> None:
    closed = machine.conductance - np.diag(machine.outside.sum(axis=1))
    network = Network(replace(machine, conductance=closed, outside=np.zeros_like(machine.outside)))
    films = np.ones(len(FAMILIES))
    t = 20 + 10 * np.random.default_rng(1).random(len(machine.nodes))
    heat = np.zeros_like(t)
    heat[machine.node("c_stator")] = 500.0
    before = machine.capacity @ t
    for _ in range(100):
        t = network.step(t, films, heat, np.zeros(len(ZONES)), 30.0)
    assert machine.capacity @ t - before == pytest.approx(500.0 * 3000.0, rel=1e-6)


@pytest.mark.parametrize("wet", [0.0, 1.0, 1000.0])
def test_steady_state_gives_away_what_comes_in_at_any_film(machine: Parameters, wet: float) -> None:
    network, films = Network(machine), np.array([1.0, wet, 0.5, 0.0])
    zones = np.full(len(ZONES), 20.0)
    heat = machine.heat_to @ np.full(machine.heat_to.shape[1], 50.0)
    t = network.steady(films, heat, zones)
    given = machine.outside.sum(axis=1) @ t - machine.outside.sum() * 20.0
    assert given == pytest.approx(heat.sum(), rel=1e-9)
    assert t.min() >= 20.0
    assert network.step(t, films, heat, zones, 30.0) == pytest.approx(t, abs=1e-9)


def test_step_is_second_order_against_the_matrix_exponential(machine: Parameters) -> None:
    from scipy.linalg import expm

    films, n = np.array([1.0, 0.0, 0.3, 0.0]), len(machine.nodes)
    network = Network(machine)
    rate = network.rate(films) / machine.capacity[:, None]
    start = 20 + 5 * np.random.default_rng(2).random(n)
    exact = expm(-rate * 3600.0) @ start
    far = []
    for dt in (60.0, 30.0):
        t = start
        for _ in range(int(3600 / dt)):
            t = network.step(t, films, np.zeros(n), np.zeros(len(ZONES)), dt)
        far.append(float(np.abs(t - exact).max()))
    assert far[1] < 2e-3
    assert far[0] / far[1] > 3.0


def test_slowest_time_constant_is_that_of_a_heavy_machine(machine: Parameters) -> None:
    rate = Network(machine).rate(np.array([1.0, 0.0, 0.0, 0.0])) / machine.capacity[:, None]
    modes = np.linalg.eigvals(rate).real
    assert modes.min() > 0
    hours = np.sort(1 / modes)[::-1] / 3600
    assert 10 < hours[0] < 150


def test_only_the_causes_decide_not_how_the_caller_cuts_the_time(machine: Parameters) -> None:
    drive = MachineDrive(speed_c=600, spindle_speed=9000, coolant_on=True)
    whole, sliced = Plant(machine, Environment(), 3), Plant(machine, Environment(), 3)
    whole.advance(7200, drive)
    for time_s in np.cumsum(np.random.default_rng(0).uniform(0.1, 40.0, 1000)):
        sliced.advance(min(float(time_s), 7200.0), drive)
        sliced.sensors()
    sliced.advance(7200, drive)
    assert sliced.errors() == pytest.approx(whole.errors(), abs=1e-9)
    assert sliced.sensors() == whole.sensors()


def test_a_change_within_a_step_counts_by_its_share(machine: Parameters) -> None:
    plant, base, full = (Plant(machine, CALM, 3) for _ in range(3))
    plant.advance(15, MachineDrive(speed_x=20000))
    plant.advance(30, MachineDrive())
    base.advance(30, MachineDrive())
    full.advance(30, MachineDrive(speed_x=20000))
    nut = machine.node("x_nut")
    half = (full.temperatures[nut] + base.temperatures[nut]) / 2
    assert plant.temperatures[nut] == pytest.approx(half, abs=1e-6)


def test_same_seed_same_run_other_seed_other_hall(machine: Parameters) -> None:
    drives = [MachineDrive(speed_y=9000)] * 24
    one, two, other = (record(Plant(machine, Environment(), seed), drives) for seed in (4, 4, 5))
    assert np.array_equal(one.inputs, two.inputs)
    assert np.array_equal(one.errors, two.errors)
    assert not np.allclose(one.errors, other.errors)


def test_reading_is_lagged_noisy_and_repeatable(machine: Parameters) -> None:
    plant = Plant(machine, CALM, 6)
    rest = [plant.sensors()["a_drive"]]
    assert plant.sensors()["a_drive"] == rest[0]
    for k in range(1, 121):
        plant.advance(30.0 * k, MachineDrive(powered=False))
        rest.append(plant.sensors()["a_drive"])
    assert 0.035 < np.std(np.diff(rest)) / math.sqrt(2) < 0.065


@pytest.mark.parametrize(
    ("drive", "source", "low", "high"),
    [
        (MachineDrive(spindle_speed=18000), "spindle", 500, 800),
        (MachineDrive(speed_c=1200), "c_", 700, 1000),
        (MachineDrive(speed_a=40), "a_", 100, 150),
        (MachineDrive(speed_x=30000), "x_", 100, 150),
        (MachineDrive(speed_y=30000), "y_", 100, 150),
    ],
)
def test_heat_is_of_the_known_size(
    machine: Parameters, drive: MachineDrive, source: str, low: float, high: float
) -> None:
    nodes = [k for k, name in enumerate(machine.nodes) if name.startswith("sp_" if source == "spindle" else source)]
    watts = float((machine.heat_to @ loads(machine, drive).heat_W)[nodes].sum())
    assert low <= watts <= high


def test_coolant_carries_most_of_the_spindles_heat(machine: Parameters) -> None:
    heat = np.zeros(len(machine.nodes))
    for k, law in enumerate(machine.laws):
        if law.drive == "spindle_speed":
            heat += machine.heat_to[:, k] * (law.linear + law.power)
    network, films = Network(machine), np.array([1.0, 0.0, 0.0, 1.0])
    cold = network.rate(films)
    cold[machine.node("coolant_tank")] += 1e9 * np.eye(len(heat))[machine.node("coolant_tank")]
    t = np.linalg.solve(cold, heat)
    share = machine.flow_rate_W_K * (t[machine.node("jacket_s")] - t[machine.node("coolant_tank")]) / heat.sum()
    assert 0.6 <= share <= 0.8


def test_cutting_fluid_cools_a_hot_table(machine: Parameters) -> None:
    dry, wet = Plant(machine, CALM, 1), Plant(machine, CALM, 1)
    dry.advance(4 * 3600, MachineDrive(speed_c=1000))
    wet.advance(4 * 3600, MachineDrive(speed_c=1000, coolant_on=True))
    table = machine.node("c_table")
    assert dry.temperatures[table] - wet.temperatures[table] > 2.0


def test_equal_warming_of_both_sides_tilts_nothing_sideways(machine: Parameters) -> None:
    warmer = np.ones(len(machine.nodes))
    nine = dict(zip(THERMAL_ERRORS, machine.elastic @ warmer, strict=True))
    for name in ("EA0C", "EB0C", "EC0C"):
        assert nine[name] == pytest.approx(0.0, abs=1e-9)
    assert nine["ER0T"] == pytest.approx(11.5e-6 * 200e3)


def test_deviation_is_the_probing_formula(machine: Parameters) -> None:
    plant = Plant(machine, Environment(), 2)
    plant.advance(6 * 3600, MachineDrive(speed_c=900, speed_a=20))
    e = dict(zip(THERMAL_ERRORS, plant.errors(), strict=True))
    for a_deg, c_deg in ((0, 0), (0, 90), (0, 180), (0, 270), (90, 0), (-90, 0), (30, 50)):
        a, c = math.radians(a_deg), math.radians(c_deg)
        rx = np.array([[1, 0, 0], [0, math.cos(a), -math.sin(a)], [0, math.sin(a), math.cos(a)]])
        at_c = np.array([200 * math.cos(c), 200 * math.sin(c), 80.0])
        inside = np.array([e["EX0C"], e["EY0C"], e["EZ0T"]]) + e["ER0T"] * np.array([math.cos(c), math.sin(c), 0])
        inside += np.cross([e["EA0C"], e["EB0C"], e["EC0C"]], at_c * 1e-3)
        expected = np.array([0, e["EY0A"], e["EZ0A"]]) + rx @ inside
        x, y, z = rx @ at_c
        assert plant.deviation_um(x, y, z, a_deg, c_deg) == pytest.approx(expected, abs=0.01)


def test_errors_start_at_zero_and_reach_tens_of_micrometres(machine: Parameters) -> None:
    plant = Plant(machine, Environment(), 7)
    assert not plant.errors().any()
    draw = np.random.default_rng(5)
    drives: list[MachineDrive] = []
    axes = [MachineDrive(), MachineDrive(speed_c=800), MachineDrive(speed_a=25), MachineDrive(speed_x=20000)]
    axes += [MachineDrive(speed_y=20000), MachineDrive(spindle_speed=12000)]
    while len(drives) < 864:
        drives += [replace(axes[draw.integers(6)], coolant_on=bool(draw.random() < 0.4))] * int(draw.integers(6, 36))
    swing = dict(zip(THERMAL_ERRORS, np.ptp(record(plant, drives[:864]).errors, axis=0), strict=True))
    assert 15 < swing["EX0C"] < 100
    assert 20 < swing["EZ0A"] < 100
    assert 15 < swing["EZ0T"] < 100
    assert swing["EY0C"] < 10
    assert swing["EY0A"] < 20
