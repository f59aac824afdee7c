"""The five-axis machine at run time: balances, stability at any film, instruments, magnitudes."""

import math
from dataclasses import replace

import numpy as np
import pytest

from simulators.plant import (
    MACHINES,
    Ageing,
    Environment,
    Failure,
    FailureKind,
    MachineDrive,
    Plant,
    PlantParameters,
    load_machine,
    record_drive,
)
from simulators.plant.drive import loads
from simulators.plant.joined import FAMILIES, ZONES
from simulators.plant.network import Network
from talc.names import THERMAL_ERRORS

CALM = Environment(daily_amplitude_K=0, weather_sigma_K=0, gradient_K_m=0, door_openings_per_day=0)


NEW = Ageing(friction_sigma=0, sensor_K_per_100h=0)


@pytest.fixture(scope="module")
def machine() -> PlantParameters:
    return load_machine()


@pytest.fixture(scope="module", params=MACHINES)
def any_machine(request: pytest.FixtureRequest) -> PlantParameters:
    return load_machine(request.param)


def shut(machine: PlantParameters) -> PlantParameters:
    """The same machine without any path for heat to the hall."""
    given = machine.outside.sum(axis=1)
    drain = np.zeros_like(machine.conductance)
    # What leaves at a coordinate is taken from an evenly warm machine: rank one, so that even stays even.
    for column in machine.outside.T:
        if column.any():
            drain += np.outer(column, column) / (column @ machine.even)
    closed = machine.conductance - drain
    assert np.allclose(machine.conductance @ machine.even, given)
    return replace(machine, conductance=closed, outside=np.zeros_like(machine.outside))


def test_names_are_those_of_the_bench(machine: PlantParameters) -> None:
    assert len(machine.channels) == 29
    assert {"bed_front_left", "spindle_motor", "ambient_high", "space_right", "cutting_fluid"} <= set(machine.channels)
    even = np.concatenate([machine.even, np.ones(len(ZONES))])
    assert machine.sensor_at @ even == pytest.approx(1.0)


def test_an_evenly_warm_machine_in_as_warm_a_hall_stays_so_at_any_film(any_machine: PlantParameters) -> None:
    network, even = Network(any_machine), any_machine.even
    for seed in range(5):
        films = 10 ** np.random.default_rng(seed).uniform(-2, 3, len(FAMILIES))
        after = network.step(25 * even, films, np.zeros_like(even), np.full(len(ZONES), 25.0), 300.0)
        assert after == pytest.approx(25 * even, rel=1e-7, abs=1e-6 * abs(25 * even).max())


def test_heat_without_way_out_stays(machine: PlantParameters) -> None:
    network = Network(shut(machine))
    films = np.ones(len(FAMILIES))
    x = 20 * machine.even
    stored = machine.even * machine.capacity
    before = stored @ x
    for _ in range(100):
        x = network.step(x, films, 500.0 * machine.places["c_stator"], np.zeros(len(ZONES)), 30.0)
    assert stored @ x - before == pytest.approx(500.0 * 3000.0, rel=1e-6)


@pytest.mark.parametrize("wet", [0.0, 1.0, 1000.0])
def test_steady_state_gives_away_what_comes_in_at_any_film(any_machine: PlantParameters, wet: float) -> None:
    machine = any_machine
    network, films = Network(machine), np.array([1.0, wet, 0.5, 0.0])
    zones = np.full(len(ZONES), 20.0)
    heat = machine.heat_to @ np.full(machine.heat_to.shape[1], 50.0)
    x = network.steady(films, heat, zones)
    given = machine.outside.sum(axis=1) @ (x - 20.0 * machine.even)
    assert given == pytest.approx(50.0 * machine.heat_to.shape[1], rel=1e-9)
    assert min(row @ x for row in machine.places.values()) >= 20.0 - 1e-6
    assert network.step(x, films, heat, zones, 30.0) == pytest.approx(x, abs=1e-9 * abs(x).max())


def test_matrices_are_symmetric_and_every_film_draws_energy(any_machine: PlantParameters) -> None:
    machine = any_machine
    for name, matrix in (("K", machine.conductance), *zip(FAMILIES, machine.films, strict=True)):
        if name != "flow":
            assert np.allclose(matrix, matrix.T, atol=1e-9), name
        # The coolant's one way makes `flow` unsymmetric; what it draws, x' H x, is still never negative.
        drawn = np.linalg.eigvalsh((matrix + matrix.T) / 2)
        assert drawn.min() > -1e-9 * drawn.max(), name


def test_no_film_makes_it_unstable(any_machine: PlantParameters) -> None:
    network = Network(any_machine)
    draw = np.random.default_rng(8)
    root = np.sqrt(any_machine.capacity)
    for _ in range(40):
        films = 10 ** draw.uniform(-3, 4, len(FAMILIES)) * (draw.random(len(FAMILIES)) < 0.8)
        scaled = network.rate(films) / root[:, None] / root
        assert np.linalg.eigvals(scaled).real.min() > 0
        x = draw.standard_normal(root.size)
        for dt in (1.0, 30.0, 3e4):
            after = network.step(x / root, films, np.zeros_like(x), np.zeros(len(ZONES)), dt)
            assert np.linalg.norm(root * after) <= np.linalg.norm(x) * (1 + 1e-9)


def test_step_is_second_order_against_the_matrix_exponential(machine: PlantParameters) -> None:
    from scipy.linalg import expm

    films, n = np.array([1.0, 0.0, 0.25, 0.0]), machine.even.size
    network = Network(machine)
    rate = network.rate(films) / machine.capacity[:, None]
    start = Network(machine).steady(films, 50 * machine.heat_to.sum(axis=1), np.zeros(len(ZONES)))
    exact = expm(-rate * 3600.0) @ start
    seen = np.array(list(machine.places.values()))
    far = []
    for dt in (60.0, 30.0):
        t = start
        for _ in range(int(3600 / dt)):
            t = network.step(t, films, np.zeros(n), np.zeros(len(ZONES)), dt)
        far.append(float(np.abs(seen @ (t - exact)).max()))
    assert far[1] < 5e-3
    assert far[0] / far[1] > 3.0


def test_slowest_time_constant_is_that_of_a_heavy_machine(machine: PlantParameters) -> None:
    rate = Network(machine).rate(np.array([1.0, 0.0, 0.0, 0.0])) / machine.capacity[:, None]
    modes = np.linalg.eigvals(rate).real
    assert modes.min() > 0
    hours = np.sort(1 / modes)[::-1] / 3600
    assert 10 < hours[0] < 150


@pytest.mark.parametrize(
    ("place", "wet", "low_min", "high_min"),
    [
        ("sp_front", 0, 3, 20),
        ("sp_rear", 0, 3, 20),
        ("sp_motor", 0, 3, 20),
        ("c_bearing", 0, 3, 20),
        ("a_drive", 0, 3, 20),
        ("fluid_tank", 1, 60, 120),
    ],
)
def test_lumped_parts_are_as_quick_as_their_kind(
    machine: PlantParameters, place: str, wet: float, low_min: float, high_min: float
) -> None:
    k = int(np.flatnonzero(machine.places[place])[0])
    rate = Network(machine).rate(np.array([1.0, wet, 0.0, 0.0]))
    assert low_min < machine.capacity[k] / rate[k, k] / 60 < high_min


def test_only_the_causes_decide_not_how_the_caller_cuts_the_time(machine: PlantParameters) -> None:
    drive = MachineDrive(speed_c=600, spindle_speed=9000, coolant_on=True)
    whole, sliced = Plant(machine, Environment(), 3), Plant(machine, Environment(), 3)
    whole.advance(7200, drive)
    for time_s in np.cumsum(np.random.default_rng(0).uniform(0.1, 40.0, 1000)):
        sliced.advance(min(float(time_s), 7200.0), drive)
        sliced.sensors()
    sliced.advance(7200, drive)
    assert sliced.errors() == pytest.approx(whole.errors(), abs=1e-9)
    assert sliced.sensors() == whole.sensors()


def test_a_change_within_a_step_counts_by_its_share(machine: PlantParameters) -> None:
    plant, base, full = (Plant(machine, CALM, 3, ageing=NEW) for _ in range(3))
    plant.advance(15, MachineDrive(speed_x=20000))
    plant.advance(30, MachineDrive())
    base.advance(30, MachineDrive())
    full.advance(30, MachineDrive(speed_x=20000))
    half = (full.temperature("x_nut") + base.temperature("x_nut")) / 2
    assert plant.temperature("x_nut") == pytest.approx(half, abs=1e-6)


def test_same_seed_same_run_other_seed_other_hall(machine: PlantParameters) -> None:
    drives = [MachineDrive(speed_y=9000)] * 24
    one, two, other = (record_drive(Plant(machine, Environment(), seed), drives) for seed in (4, 4, 5))
    assert np.array_equal(one.inputs, two.inputs)
    assert np.array_equal(one.errors, two.errors)
    assert not np.allclose(one.errors, other.errors)


def test_reading_is_lagged_noisy_and_repeatable(machine: PlantParameters) -> None:
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
    machine: PlantParameters, drive: MachineDrive, source: str, low: float, high: float
) -> None:
    names = {"spindle": "spindle_speed", "c_": "speed_c", "a_": "speed_a", "x_": "speed_x", "y_": "speed_y"}
    mine = [law.drive == names[source] for law in machine.laws]
    watts = float(loads(machine, drive).heat_W[mine].sum())
    assert low <= watts <= high


def test_coolant_carries_most_of_the_spindles_heat(machine: PlantParameters) -> None:
    heat = np.zeros_like(machine.even)
    for k, law in enumerate(machine.laws):
        if law.drive == "spindle_speed":
            heat += machine.heat_to[:, k] * (law.linear + law.power)
    tank, jacket = machine.places["coolant_tank"], machine.places["jacket_s"]
    cold = Network(machine).rate(np.array([1.0, 0.0, 0.0, 1.0])) + 1e9 * np.outer(tank, tank)
    x = np.linalg.solve(cold, heat)
    share = machine.flow_rate_W_K * float((jacket - tank) @ x) / float(machine.even @ heat)
    assert 0.6 <= share <= 0.8


def test_cutting_fluid_cools_a_hot_table(machine: PlantParameters) -> None:
    dry, wet = Plant(machine, CALM, 1), Plant(machine, CALM, 1)
    dry.advance(4 * 3600, MachineDrive(speed_c=1000))
    wet.advance(4 * 3600, MachineDrive(speed_c=1000, coolant_on=True))
    assert dry.temperature("table.top") - wet.temperature("table.top") > 2.0


def test_even_warming_is_free_growth(any_machine: PlantParameters) -> None:
    """Cast iron 10.5, steel 11.5e-6: table's radius 200 mm, its top 20 mm and the post of 60 mm above the A axis."""
    nine = dict(zip(THERMAL_ERRORS, any_machine.elastic @ any_machine.even, strict=True))
    assert nine["ER0T"] == pytest.approx(11.5 * 0.2, rel=0.01)
    assert nine["EZ0T"] == pytest.approx(10.5 * -0.08 + 11.5 * (0.1 + 0.06), rel=0.02)
    assert nine["EZ0A"] == pytest.approx(-10.5 * 0.55 + 11.5 * 0.25, abs=0.06)  # flange at 0.55 m, nose at 0.3 m
    for name in ("EY0A", "EX0C", "EY0C", "EA0C", "EB0C", "EC0C"):
        assert nine[name] == pytest.approx(0.0, abs=0.02), name


def test_deviation_is_the_probing_formula(machine: PlantParameters) -> None:
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


def test_errors_start_at_zero_and_reach_tens_of_micrometres(machine: PlantParameters) -> None:
    plant = Plant(machine, Environment(), 7)
    assert not plant.errors().any()
    draw = np.random.default_rng(5)
    drives: list[MachineDrive] = []
    axes = [MachineDrive(), MachineDrive(speed_c=800), MachineDrive(speed_a=25), MachineDrive(speed_x=20000)]
    axes += [MachineDrive(speed_y=20000), MachineDrive(spindle_speed=12000)]
    while len(drives) < 864:
        drives += [replace(axes[draw.integers(6)], coolant_on=bool(draw.random() < 0.4))] * int(draw.integers(6, 36))
    swing = dict(zip(THERMAL_ERRORS, np.ptp(record_drive(plant, drives[:864]).errors, axis=0), strict=True))
    assert 5 < swing["EX0C"] < 100
    assert 20 < swing["EZ0A"] < 100
    assert 10 < swing["EZ0T"] < 100
    assert swing["EY0C"] < 10
    assert 5 < swing["EY0A"] < 50


def test_stiff_machine_bends_less_warm_one_more_cooled_spindle_grows_less() -> None:
    drives = [MachineDrive(spindle_speed=12000)] * 48 + [MachineDrive(speed_c=1000, speed_x=20000)] * 48
    swing, growth = {}, {}
    for name in MACHINES:
        run = record_drive(Plant(load_machine(name), CALM, 1, ageing=NEW), drives)
        swing[name] = dict(zip(THERMAL_ERRORS, np.ptp(run.errors, axis=0), strict=True))
        growth[name] = float(np.ptp(run.inputs[:, 29]))
    assert swing["stiff"]["EA0C"] < 0.9 * swing["base"]["EA0C"]
    assert swing["warm"]["ER0T"] > 1.2 * swing["base"]["ER0T"]
    assert growth["cooled_spindle"] < 0.6 * growth["base"]
    with pytest.raises(ValueError, match="machine 'weak': expected one of base, stiff"):
        load_machine("weak")


def test_friction_and_sensors_drift_slowly_and_repeatably(machine: PlantParameters) -> None:
    old, again, new = (Plant(machine, CALM, 2, ageing=a) for a in (Ageing(), Ageing(), NEW))
    drives = [MachineDrive(speed_x=20000, speed_y=20000)] * 12 * 24
    runs = [record_drive(plant, drives) for plant in (old, again, new)]
    assert np.array_equal(runs[0].inputs, runs[1].inputs)
    apart = np.abs(runs[0].errors - runs[2].errors).max()
    assert 0.1 < apart < 10
    offset = runs[0].inputs[-1, :29] - runs[2].inputs[-1, :29]
    ground = [machine.channels.index(name) for name in ("ambient_front", "ambient_left", "ambient_high")]
    assert 0 < np.abs(offset[ground]).max() < 0.2  # the hall is the same: what differs is the sensor's drift


def test_sensors_fail_as_specified(machine: PlantParameters) -> None:
    failures = (
        Failure(channel="x_nut", kind=FailureKind.OPEN, from_s=600, until_s=1200),
        Failure(channel="c_drive", kind=FailureKind.STUCK, from_s=600),
        Failure(channel="y_nut", kind=FailureKind.OFFSET, from_s=600, by_K=4.0),
    )
    drives = [MachineDrive(speed_c=1200, speed_y=30000)] * 8
    bad = record_drive(Plant(machine, CALM, 2, failures=failures), drives).inputs
    good = record_drive(Plant(machine, CALM, 2), drives).inputs
    x, c, y = (machine.channels.index(name) for name in ("x_nut", "c_drive", "y_nut"))
    assert np.isnan(bad[:, x]).tolist() == [False, True, True, False, False, False, False, False]
    assert np.ptp(bad[1:, c]) == 0 < np.ptp(good[1:, c])
    assert bad[1:, y] - good[1:, y] == pytest.approx(4.0)
    others = [k for k in range(bad.shape[1]) if k not in (x, c, y)]
    assert np.array_equal(bad[:, others], good[:, others])
    with pytest.raises(ValueError, match="no channel 'x_nutt'"):
        Plant(machine, CALM, 2, failures=[Failure(channel="x_nutt", kind=FailureKind.OPEN, from_s=0)])


def test_another_plant_counts_from_the_same_state(machine: PlantParameters) -> None:
    """After its reference measurement a plant gives the same values as its twin that takes the reference from it."""
    drive = MachineDrive(speed_c=900.0)
    plant, twin = Plant(machine, CALM, 1), Plant(machine, CALM, 1)
    for one in (plant, twin):
        one.advance(1800.0, drive)
    plant.zero()
    for one in (plant, twin):
        one.advance(3600.0, drive)
    assert not np.allclose(twin.errors(), plant.errors())
    twin.zero(plant)
    assert np.array_equal(twin.errors(), plant.errors())
    with pytest.raises(ValueError, match="same parameters"):
        twin.zero(Plant(load_machine("stiff"), CALM, 1))
