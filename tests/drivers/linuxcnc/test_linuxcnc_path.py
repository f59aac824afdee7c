"""The probing cycle's path against the machine's travel, without LinuxCNC, by an independent kinematics."""

import configparser
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from simulators.linuxcnc.machine import FILES
from talc.frame import FloatArray
from talc.probing import rotation_x, rotation_z
from tests.benches.linuxcnc_module import linuxcnc_module

PROBE = {"X": 0.5, "Y": -0.25, "Z": 60.0, "A": 0.0, "C": 0.0}
WIDE = dict.fromkeys("XYZAC", (-1e4, 1e4))
SPHERE = np.array([120.0, 0.0, 80.0])
BALL_MM, CLEAR_MM, SAFE_MM, REACH_MM = 13.0, 30.0, 200.0, 3.0
POSES = [(0, 0), (0, 90), (0, 180), (0, 270), (90, 0), (-90, 0)]


@pytest.fixture
def modules(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(FILES))
    return linuxcnc_module("talc_joints"), linuxcnc_module("talc_path")


def path(modules: Any, on_abort: str = "O <talc_abort> call", joints: str = "XYZAC", **changed: str) -> Any:
    """By talc.ini as shipped, with other values in [TALC]. joints: the axis of each, one letter twice for a gantry."""
    ini = configparser.RawConfigParser(strict=False)
    ini.optionxform = str  # type: ignore[assignment,method-assign]
    ini.read(FILES / "talc.ini")
    ini["TALC"].update(changed)
    ini["RS274NGC"]["ON_ABORT_COMMAND"] = on_abort
    kind = {axis: dict(ini[f"JOINT_{n}"]) for n, axis in enumerate("XYZAC")}
    ini.read_dict({f"JOINT_{n}": kind[axis] for n, axis in enumerate(joints)})
    ini["KINS"].update(JOINTS=str(len(joints)), KINEMATICS=f"xyzac-trt-kins coordinates={joints}")
    ini["TRAJ"]["COORDINATES"] = joints
    machines, paths = modules
    return paths.ProbingPath(
        machines.MachineJoints(lambda section, name: ini.get(section, name, fallback=None), "mill")
    )


def spindle_at(a_deg: float, c_deg: float, off_mm: FloatArray) -> Iterator[FloatArray]:
    """Places of the spindle's gauge point in a pose, when the first round has found the sphere this far off."""
    tool = np.array([PROBE[axis] for axis in "XYZ"])
    centre = rotation_x(np.radians(a_deg)) @ rotation_z(np.radians(c_deg)) @ SPHERE + off_mm
    for axis in range(3):
        for side in (-1.0, 1.0) if axis < 2 else (1.0,):
            beside = centre.copy()
            beside[axis] += side * (BALL_MM + REACH_MM)
            above = np.array([*beside[:2], centre[2] + BALL_MM + CLEAR_MM])
            yield from (place + tool for place in (beside, above, np.array([*centre[:2], SAFE_MM])))


def test_as_shipped_a_probe_of_up_to_100_mm_finds_room_and_a_longer_one_is_refused(modules: Any) -> None:
    limits = dict.fromkeys("XYZ", (-300.0, 300.0)) | {"A": (-120.0, 120.0), "C": (-36000.0, 36000.0)}
    it = path(modules)
    for length in (60.0, 100.0):
        assert it.beyond(PROBE | {"Z": length}, limits) == ""
    assert "Z = 300.1 with the probe in the spindle, beyond the limit 300" in it.beyond(PROBE | {"Z": 100.1}, limits)
    high = path(modules, SAFE_Z="250")
    assert "needs Z = 310.0" in high.beyond(PROBE, limits), "it would have ended the part program in its first cycle"


@pytest.mark.parametrize(("a", "c"), [*POSES, (60, 30), (-50, 200)])
def test_a_pose_needs_the_travel_to_its_outermost_places_and_no_more(a: float, c: float, modules: Any) -> None:
    """A touch finds the sphere up to REACH off its place, and the second round goes around where it was found."""
    everywhere = {f"POSE_{pose}_{axis}": str(at) for pose in range(6) for axis, at in (("A", a), ("C", c))}
    it = path(modules, **everywhere)
    off = np.vstack([np.zeros(3), REACH_MM * np.eye(3), -REACH_MM * np.eye(3)])
    places = np.array([place for mm in off for place in spindle_at(a, c, mm)])
    for axis, low, high in zip("XYZ", places.min(axis=0), places.max(axis=0), strict=True):
        for limits, fits in (
            ((low - 1e-6, high + 1e-6), True),
            ((low + 1e-3, 1e4), False),
            ((-1e4, high - 1e-3), False),
        ):
            assert (it.beyond(PROBE, WIDE | {axis: limits}) == "") is fits, (axis, limits)


@pytest.mark.parametrize(
    ("limits", "said"),
    [
        ({"A": (-120.0, 45.0)}, "pose 5 needs A = 90.0 with the probe in the spindle, beyond the limit 45:"),
        ({"A": (-30.0, 120.0)}, "pose 6 needs A = -90.0 "),
        ({"C": (-180.0, 180.0)}, "pose 4 needs C = 270.0 "),
    ],
)
def test_the_table_s_axes_are_compared_too(limits: dict[str, tuple[float, float]], said: str, modules: Any) -> None:
    assert path(modules).beyond(PROBE, WIDE | limits).startswith(said)


@pytest.mark.parametrize("end", ["min_position_limit", "max_position_limit"])
@pytest.mark.parametrize(
    ("coordinates", "joint", "needs"), [("XYZAC", 0, "X"), ("XYZAC", 2, "Z"), ("XYZAC", 3, "A"), ("XYYZAC", 2, "Y")]
)
def test_a_joint_that_reaches_less_far_than_its_axis_counts(
    coordinates: str, joint: int, needs: str, end: str, modules: Any
) -> None:
    """Also the second one of a gantry."""
    wide = {"min_position_limit": -1e4, "max_position_limit": 1e4}
    it = path(modules, joints=coordinates)
    probe = SimpleNamespace(id=99, **{f"{axis.lower()}offset": at for axis, at in PROBE.items()})
    joints = [wide for _ in coordinates]
    nc = SimpleNamespace(
        axis=[wide] * 9, joint=joints, tool_table=[probe], joint_actual_position=[0.0] * len(coordinates)
    )
    assert it.obstacle(nc, 0.0) == ""
    joints[joint] = wide | {end: 70.0 if end.startswith("max") else 64.0}
    refused = it.obstacle(nc, 0.0)
    assert refused.code == "beyond_travel"
    assert f"needs {needs} = " in refused


def test_the_pivot_the_turns_of_c_and_a_dry_run_s_height_count(modules: Any) -> None:
    it = path(modules, PIVOT_X="7", PIVOT_Z="-30")
    room = {"X": (-136.0, 160.0), "Z": (-1e4, 230.1)}
    assert it.beyond(PROBE, WIDE | room) == ""
    assert it.beyond(PROBE, WIDE | {"C": (0.0, 360.0)}, turns_deg=360.0).startswith("pose 2 needs C = 450.0")
    assert it.beyond(PROBE, WIDE | room, dry_run_mm=100.0).startswith("pose 1 needs Z = 256.0")
    assert it.least_dry_run_mm() == BALL_MM + 2 * REACH_MM


@pytest.mark.parametrize(
    ("c_deg", "turns_deg"),
    [
        (0.0, [0.0]), (179.9, [0.0]), (180.1, [360.0]), (-200.0, [-360.0]),
        (180.0, [0.0, 360.0]), (-180.0, [-360.0, 0.0]), (900.0, [720.0, 1080.0]),
    ],
)  # fmt: skip
def test_half_way_between_two_turns_both_count(c_deg: float, turns_deg: list[float], modules: Any) -> None:
    """There ROUND of LinuxCNC goes away from zero, and an encoder may show either side."""
    _, paths = modules
    assert paths.full_turns_deg(c_deg) == turns_deg


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"SAFE_Z": "157.3"}, ""),
        ({"SAFE_Z": "157.2"}, "[TALC] SAFE_Z = 157.2: the sphere swings up to 157.2 mm over the pivot"),
        ({"POSE_3_C": ""}, "[TALC] POSE_3_C is missing: the probing program needs it"),
        ({"FEED": "nan"}, "[TALC] FEED is missing: the probing program needs it"),
        ({"APPROACH_FEED": "0"}, "[TALC] APPROACH_FEED = 0: expected more than 0"),
        ({"CLEAR": "-1"}, "[TALC] CLEAR = -1: expected more than 0"),
    ],
)
def test_a_machine_on_which_the_program_cannot_run_says_why(changed: dict[str, str], said: str, modules: Any) -> None:
    assert path(modules, **changed).unfit == said


@pytest.mark.parametrize("on_abort", ["", "O <on_abort> call", "O <talc_abort_of_mine> call"])
def test_without_its_command_after_a_stop_it_does_not_probe(on_abort: str, modules: Any) -> None:
    said = path(modules, on_abort).unfit
    assert said.startswith(f"mill, [RS274NGC] ON_ABORT_COMMAND = {on_abort}: write O <talc_abort> call")


@pytest.mark.parametrize("on_abort", ["O <talc_abort> call", "o<talc_abort>call", "o <TALC_ABORT> call"])
def test_its_command_after_a_stop_may_be_written_as_linuxcnc_reads_it(on_abort: str, modules: Any) -> None:
    assert path(modules, on_abort).unfit == ""


def test_whatever_the_path_is_made_of_changes_its_mark_and_nothing_else_does(modules: Any) -> None:
    before = path(modules).mark
    fields = [*modules[1].FIELDS, "PIVOT_X", "PIVOT_Y", "PIVOT_Z", "SPHERE_RADIUS", "PROBE_TOOL"]
    marks = [path(modules, **{name: "77"}).mark for name in fields]
    assert len({before, *marks}) == 1 + len(fields)
    assert path(modules, SAFE_Z="200.0", SLEW="0.02", PORT="7622", ADDRESS="::1").mark == before


def test_a_text_in_place_of_a_number_ends_linuxcnc_with_its_field(modules: Any) -> None:
    with pytest.raises(modules[0].Unfit, match=r"mill, \[TALC\] SAFE_Z = high: expected a number"):
        path(modules, SAFE_Z="high")


@pytest.mark.parametrize(
    ("tool", "z_mm", "low"),
    [(99, 239.9, True), (99, 240.0, False), (99, 300.0, False), (1, 0.0, False), (0, 0.0, False)],
)
def test_the_probe_alone_is_low_below_the_safe_height(tool: int, z_mm: float, low: bool, modules: Any) -> None:
    probe = SimpleNamespace(id=99, zoffset=40.0)
    nc = SimpleNamespace(tool_in_spindle=tool, tool_table=[probe], joint_actual_position=[0.0, 0.0, z_mm, 0.0, 0.0])
    assert path(modules, SAFE_Z="200").is_low(nc) is low
