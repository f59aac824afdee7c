"""Units and joints that the agent of deploy/nc/linuxcnc reads in the INI file.

Each machine is compensated at the right joints by the right length, or refused by name. In part in the real LinuxCNC,
Debian's linuxcnc-uspace.
"""

import asyncio
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.base import Refused
from drivers.nc import NineErrors, WatchdogTerms
from gateway.nc.routes import positions
from simulators.linuxcnc.machine import machine
from talc import kinematics
from talc.probing import rotation_x, rotation_z
from tests.benches.linuxcnc_bench import claimed, running
from tests.benches.linuxcnc_module import linuxcnc_module

INCH_MM = 25.4
WARM, RADIUS_MM = np.array([3.0, -48.8, 10.0, 4.0, 20.0, 12.6, 30.0, -25.0, 15.0]), 200.0
"""The radius is not the INI file's 120 mm: ER0T is converted."""


@pytest.fixture
def talc_joints() -> Any:
    """The agent's module; it needs LinuxCNC's only to open a file."""
    return linuxcnc_module("talc_joints")


LIMITS = {"MIN_LIMIT": "-300", "MAX_LIMIT": "250"}


def ini(coordinates: str = "XYZAC", **changed: str) -> dict[str, str]:
    """The fields that count, as SECTION__NAME."""
    fields = {
        "TRAJ__LINEAR_UNITS": "mm",
        "TRAJ__COORDINATES": coordinates,
        "KINS__KINEMATICS": f"trivkins coordinates={coordinates} kinstype=BOTH",
        "KINS__JOINTS": str(len(coordinates)),
        "TALC__LOWER": "-0.2",
        "TALC__BOUND": "0.2",
        "TALC__SLEW": "0.01",
        **{f"AXIS_{axis}__{end}": value for axis in "XYZ" for end, value in LIMITS.items()},
    }
    for n, axis in enumerate(coordinates):
        fields[f"JOINT_{n}__TYPE"] = "ANGULAR" if axis in "AC" else "LINEAR"
    return fields | changed


def machine_of(talc_joints: Any, fields: dict[str, str]) -> Any:
    return talc_joints.MachineJoints(lambda section, name: fields.get(f"{section}__{name}"), "mill.ini")


@pytest.mark.parametrize(
    ("unit", "mm"), [("mm", 1.0), ("METRIC", 1.0), ("inch", INCH_MM), ("in", INCH_MM), ("Imperial", INCH_MM)]
)
def test_each_name_of_a_unit_has_its_length(unit: str, mm: float, talc_joints: Any) -> None:
    bound = 0.127 / mm
    fields = ini(TRAJ__LINEAR_UNITS=unit, TALC__BOUND=f"{bound}", TALC__LOWER=f"{-2 * bound}")
    it = machine_of(talc_joints, fields)
    assert (it.mm, it.bound_um) == (mm, pytest.approx(127.0))
    fields["TALC__SLEW"] = f"{0.005 / mm}"
    assert machine_of(talc_joints, fields).values()["slew-um-per-s"] == pytest.approx(5.0)


@pytest.mark.parametrize(
    ("coordinates", "joints"),
    [
        ("XYZAC", {"X": (0,), "Y": (1,), "Z": (2,), "A": (3,), "C": (4,)}),
        ("YXZAC", {"X": (1,), "Y": (0,), "Z": (2,), "A": (3,), "C": (4,)}),
        ("CAZYX", {"X": (4,), "Y": (3,), "Z": (2,), "A": (1,), "C": (0,)}),
        ("XYYZAC", {"X": (0,), "Y": (1, 2), "Z": (3,), "A": (4,), "C": (5,)}),
        ("XYZACX", {"X": (0, 5), "Y": (1,), "Z": (2,), "A": (3,), "C": (4,)}),
    ],
)
def test_joints_are_those_of_the_kinematics(
    coordinates: str, joints: dict[str, tuple[int, ...]], talc_joints: Any
) -> None:
    assert machine_of(talc_joints, ini(coordinates)).joints == joints


def test_the_second_joint_of_a_gantry_has_its_own_name(talc_joints: Any) -> None:
    rows = machine_of(talc_joints, ini("XYYZAC")).named()
    assert rows == [("x", "X", 0), ("y", "Y", 1), ("y2", "Y", 2), ("z", "Z", 3), ("a", "A", 4), ("c", "C", 5)]


def test_the_reach_is_that_of_the_longest_tool_s_tip_from_where_a_and_c_meet(talc_joints: Any) -> None:
    fields = ini(TALC__PIVOT_X="20", TALC__PIVOT_Z="-50", TALC__LONGEST_TOOL="150")
    along, across = machine_of(talc_joints, fields).reach
    assert along == 320.0
    assert across == pytest.approx(np.hypot(300.0, max(300 - 50 + 150, 250 + 50)))
    inches = ini(TRAJ__LINEAR_UNITS="inch", TALC__LOWER="-0.01", TALC__BOUND="0.01")
    assert machine_of(talc_joints, inches).reach[0] == pytest.approx(300 * INCH_MM)


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        (ini(TRAJ__LINEAR_UNITS="cm"), r"\[TRAJ\] LINEAR_UNITS = cm: write mm or inch"),
        (ini(TRAJ__LINEAR_UNITS=""), r"\[TRAJ\] LINEAR_UNITS = : write mm or inch"),
        (ini(TRAJ__ANGULAR_UNITS="rad"), r"\[TRAJ\] ANGULAR_UNITS = rad: write deg"),
        (ini("XYZBC"), r"\[TRAJ\] COORDINATES = XYZBC: .*axes XYZAC"),
        (ini("XYZACW"), r"\[TRAJ\] COORDINATES = XYZACW: .*axes XYZAC"),
        (ini("XYZ"), r"\[TRAJ\] COORDINATES = XYZ: "),
        (ini(KINS__KINEMATICS="5axiskins"), r"\[KINS\] KINEMATICS = 5axiskins: .*trivkins or xyzac-trt-kins"),
        (ini(KINS__KINEMATICS="trivkins"), r"trivkins: its joints are XYZAB, but .*add coordinates=XYZAC"),
        (ini("YXZAC", KINS__KINEMATICS="xyzac-trt-kins"), r"its joints are XYZAC, .*add coordinates=YXZAC"),
        (ini(KINS__KINEMATICS="trivkins coordinates=XYZCA"), r"its joints are XYZCA, but .* = XYZAC"),
        (ini("XYYZAC", KINS__JOINTS="5"), r"\[KINS\] JOINTS = 5: expected 6"),
        (ini(JOINT_3__TYPE="LINEAR"), r"\[JOINT_3\] TYPE = LINEAR: joint 3 moves A: expected ANGULAR"),
        (ini(JOINT_0__TYPE="ANGULAR"), r"\[JOINT_0\] TYPE = ANGULAR: joint 0 moves X"),
        (ini(JOINT_1__UNITS="inch"), r"\[JOINT_1\] UNITS = inch: remove it"),
        (ini(TRAJ__LINEAR_UNITS="inch"), r"\[TALC\] LOWER = -0.2: -5080 µm; expected at most 0.0197 inch"),
        (ini(TALC__BOUND="nan"), r"\[TALC\] BOUND = nan: "),
        (ini(TALC__BOUND="-0.1"), r"LOWER = -0.2, BOUND = -0.1: expected LOWER < 0 < BOUND"),
        (ini(TALC__BOUND="much"), r"\[TALC\] BOUND = much: expected a number"),
        (ini(TALC__SLEW="0"), r"\[TALC\] SLEW = 0: expected more than 0, in mm/s"),
        (ini(TALC__SLEW="inf"), r"\[TALC\] SLEW = inf: "),
        (ini(TALC__SPHERE_RADIUS="0"), r"\[TALC\] SPHERE_RADIUS = 0: expected more than 0, in mm"),
        (ini(AXIS_Y__MAX_LIMIT=""), r"\[AXIS_Y\] MAX_LIMIT = : expected the end of the travel"),
    ],
)
def test_what_it_cannot_compensate_is_refused_by_name(fields: dict[str, str], says: str, talc_joints: Any) -> None:
    with pytest.raises(talc_joints.Unfit, match=rf"^mill\.ini, .*{says}"):
        machine_of(talc_joints, fields)


ROT = {"x-rot-point": 10.0, "y-rot-point": 20.0, "z-rot-point": -40.0, "z-offset": 10.0}
PIVOT = {"TALC__PIVOT_X": "10", "TALC__PIVOT_Y": "20", "TALC__PIVOT_Z": "-30"}


@pytest.mark.parametrize(
    ("kinematics", "pins", "pivot", "says"),
    [
        ("xyzac-trt-kins", {}, PIVOT, ""),
        ("xyzac-trt-kins", ROT, PIVOT, ""),
        ("trivkins coordinates=XYZAC", {"y-offset": 20.0}, PIVOT, ""),
        ("xyzac-trt-kins", ROT | {"y-offset": 0.5}, PIVOT, "xyzac-trt-kins.y-offset = 0.5: expected 0, "),
        ("xyzac-trt-kins", ROT, {}, r"mill\.ini, \[TALC\] PIVOT_X = 0 mm, but xyzac-trt-kins.x-rot-point = 10 mm: "),
        ("xyzac-trt-kins", ROT | {"z-offset": 9.0}, PIVOT, r"PIVOT_Z = -30 mm, but .*z-rot-point \+ .*z-offset = -31"),
    ],
)
def test_kinematics_that_turn_the_table_about_other_axes_are_named(
    kinematics: str, pins: dict[str, float], pivot: dict[str, str], says: str, talc_joints: Any
) -> None:
    it = machine_of(talc_joints, ini(KINS__KINEMATICS=kinematics, **pivot))
    why = it.elsewhere(lambda name: pins.get(name.removeprefix("xyzac-trt-kins."), 0.0))
    assert re.search(says, why)
    assert bool(why) == bool(says)


MACHINES = [
    pytest.param("XYZAC", {"LINEAR_UNITS": "inch", "LOWER": -0.008, "BOUND": 0.008, "SLEW": 0.04}, INCH_MM, id="inch"),
    pytest.param("XYYZAC", {"SLEW": 1}, 1.0, id="gantry"),
]


@pytest.mark.peer
@pytest.mark.slow
@pytest.mark.parametrize(("coordinates", "settings", "unit_mm"), MACHINES)
async def test_every_machine_reports_its_axes_and_moves_their_joints(
    coordinates: str, settings: dict[str, object], unit_mm: float, tmp_path: Path
) -> None:
    async with running(tmp_path, settings, coordinates=coordinates, tools="T5 P5 Z4 D1\n") as bench:
        await bench.operator.ask("mdi", "G21 T5 M6 G43")
        await bench.operator.ask("mdi", "G53 G0 X11 Y-12 Z13 A-60 C90")
        at = (await bench.snapshot()).positions
        expected = {"X": 11.0, "Y": -12.0, "Z": 13.0 - 4.0 * unit_mm, "A": -60.0, "C": 90.0}
        assert at == pytest.approx(expected, abs=1e-6)
        await claimed(bench, WatchdogTerms(600.0, 1.0))
        wanted = {"X": 11.0, "Y": -20.0, "Z": 41.6}
        await bench.nc.write_compensation((wanted["X"], wanted["Y"], wanted["Z"]))
        assert await bench.nc.read_compensation() == pytest.approx(tuple(wanted.values()), abs=1e-3)
        for n, axis in enumerate(coordinates):
            asked = await bench.operator.number("getp", f"joint.{n}.pos-cmd")
            if axis in "AC":
                driven = await bench.operator.number("getp", f"joint.{n}.motor-pos-fb")
            else:
                name = axis.lower() + ("2" if axis in coordinates[:n] else "")
                driven = await bench.pin(f"{name}-drive")
            moved_um = (driven - asked) * unit_mm * 1e3
            assert moved_um == pytest.approx(wanted.get(axis, 0.0), abs=0.01), f"joint {n}"
        await bench.nc.write_errors(NineErrors(tuple(WARM), RADIUS_MM, (150.0, 150.0, 150.0)))
        assert await bench.nc.read_errors(RADIUS_MM) == pytest.approx(tuple(WARM), abs=1e-3)
        for block in ("X100 Y-20 Z40 A30 C0", "X-80 Y50 Z-30 A-60 C77", "X0 Y0 Z0 A0 C0"):
            await bench.operator.ask("mdi", f"G53 G0 {block}")
            tip = positions(await bench.snapshot())
            there = kinematics.tcp_offsets(WARM, tip, RADIUS_MM * 1e-3)
            assert await bench.nc.read_compensation() == pytest.approx(tuple(there), abs=0.01), block


@pytest.mark.peer
@pytest.mark.slow
@pytest.mark.parametrize("period_ms", [2])
async def test_the_slew_is_per_second_whatever_the_servo_period(period_ms: int, tmp_path: Path) -> None:
    settings = {"SERVO_PERIOD": period_ms * 1_000_000, "SLEW": 0.02}
    async with running(tmp_path, settings) as bench:
        await claimed(bench, WatchdogTerms(600.0, 1.0))
        await bench.operator.ask("sample", 1, "talc-z-in-force")  # the first one loads the sampler
        writing = asyncio.create_task(bench.nc.write_compensation((0.0, 0.0, 60.0)))
        rows = await bench.operator.ask("sample", 1000 // period_ms, "talc-z-in-force")
        await writing
        moved_um = np.diff(np.array(rows)[:, 0]) * 1e3
        at_full_rate = moved_um[moved_um > 0][1:]  # what the first sampling left in the queue is older
        assert len(at_full_rate) > 100 // period_ms
        assert at_full_rate == pytest.approx(0.02 * period_ms, abs=1e-6)


@pytest.mark.peer
@pytest.mark.slow
async def test_with_tool_centre_point_kinematics_the_offsets_belong_to_where_the_tool_is(tmp_path: Path) -> None:
    """The part program moves in the table's coordinates; where the tool is then follows from rotations alone."""
    pivot, tool_mm, point = np.array([10.0, 20.0, -30.0]), 60.0, np.array([100.0, 40.0, 80.0])
    settings = {"SLEW": 1, **{f"PIVOT_{axis}": v for axis, v in zip("XYZ", pivot, strict=True)}}
    async with running(tmp_path, settings, tools=f"T5 P5 Z{tool_mm} D1\n") as bench:
        await bench.operator.ask("hal", "net", "talc-tool-z", "=>", "xyzac-trt-kins.tool-offset")
        for name, value in ROT.items():
            await bench.operator.ask("hal", "setp", f"xyzac-trt-kins.{name}", str(value))
        await bench.operator.ask("hal", "setp", "xyzac-trt-kins.y-offset", "20")
        with pytest.raises(Refused, match=r"xyzac-trt-kins\.y-offset = 20: expected 0"):
            await bench.nc.claim(7, WatchdogTerms(600.0, 1.0))
        await bench.operator.ask("hal", "setp", "xyzac-trt-kins.y-offset", "0")
        await claimed(bench, WatchdogTerms(600.0, 1.0))
        await bench.nc.write_errors(NineErrors(tuple(WARM), RADIUS_MM, (150.0, 150.0, 150.0)))
        for kinematics_type in (0, 1):
            await bench.operator.ask("hal", "setp", "motion.switchkins-type", str(kinematics_type))
            await bench.operator.ask("mdi", "G21 G90 T5 M6 G43")
            for a, c in ((0.0, 0.0), (30.0, 90.0), (-60.0, 200.0)):
                x, y, z = point + pivot
                await bench.operator.ask("mdi", f"G0 X{x} Y{y} Z{z} A{a} C{c}")
                turned = rotation_x(np.radians(a)) @ rotation_z(np.radians(c)) @ point
                tip = np.array([*(turned if kinematics_type else point), np.radians(a), np.radians(c)])
                assert positions(await bench.snapshot()) == pytest.approx(tip, abs=1e-6)
                there = kinematics.tcp_offsets(WARM, tip, RADIUS_MM * 1e-3)
                assert await bench.nc.read_compensation() == pytest.approx(tuple(there), abs=0.01)


@pytest.mark.peer
async def test_linuxcnc_does_not_start_with_a_machine_that_is_not_understood(tmp_path: Path) -> None:
    with pytest.raises(ConnectionError, match=r"\[TALC\] LOWER = -0\.2: -5080 µm; expected at most 0\.0197 inch"):
        async with machine(tmp_path, settings={"LINEAR_UNITS": "inch"}):
            pass
