"""What the probing cycle for a SINUMERIK does, run by an interpreter of its words (tests/benches/part_program.py)."""

import math
from typing import Any

import pytest

from drivers.sinumerik.control import PROBING_REASONS
from simulators.nc import CycleSettings
from tests.benches.part_program import PartPrograms, ProbedMachine

NOMINAL = CycleSettings()
CONTACT_MM, TABLE_MM = 13.0, 200.0
POSES = range(len(NOMINAL.poses_deg))
STATE, REASON = 65, 66


def cell(**data: Any) -> PartPrograms:
    """The sphere stands beside where the programs expect it."""
    nominal = [NOMINAL.nominal_centre_mm(pose) for pose in POSES]
    machine = ProbedMachine((NOMINAL.radius_mm + 0.4, -0.3, NOMINAL.height_mm + 0.2), TABLE_MM, CONTACT_MM)
    taught = {f"TALC_{axis}": [centre[i] for centre in nominal] for i, axis in enumerate("XYZ")}
    programs = PartPrograms(machine, {**taught, "TALC_SAFE_Z": 300.0, **data})
    programs.r[60], programs.r[62] = 7.0, 900.0
    return programs


def test_it_finds_the_centre_at_each_pose_and_meets_nothing_on_its_way() -> None:
    programs = cell()
    programs.safe_point()
    assert programs.r[64:68] == [7, 3, 0, 7]
    for pose in POSES:
        found = programs.r[70 + 3 * pose : 73 + 3 * pose]
        assert found == pytest.approx(programs.machine.centre(*NOMINAL.poses_deg[pose]), abs=0.002), pose
    assert programs.r[88] < 0.01


def test_offsets_are_frozen_and_let_go_at_one_place_over_the_sphere() -> None:
    programs = cell()
    programs.safe_point()
    places = {value: at for number, value, at in programs.r.written if number == STATE}
    assert list(places) == [0, 1, 2, 3]
    assert places[2] == places[3]
    assert places[1] != places[2]
    x, y, _ = NOMINAL.nominal_centre_mm(0)
    assert [places[2][axis] for axis in "XYAC"] == [x, y, *NOMINAL.poses_deg[0]]


def test_a_height_at_which_it_would_meet_the_sphere_is_refused_before_anything_moves() -> None:
    highest = NOMINAL.height_mm + CONTACT_MM + 30.0
    programs = cell(TALC_SAFE_Z=highest - 0.1)
    before = dict(programs.machine.at)
    programs.safe_point()
    assert (programs.r[STATE], programs.machine.at, programs.machine.tool) == (4, before, 3)
    assert "TALC_SAFE_Z" in PROBING_REASONS[int(programs.r[REASON])]


def test_a_touch_without_a_sphere_fails_and_leaves_the_probe_above_it() -> None:
    programs = cell()
    programs.machine.present = False
    programs.safe_point()
    assert (programs.r[STATE], programs.r[REASON], programs.r[67]) == (5, 6, 0)
    assert programs.machine.at["Z"] > NOMINAL.height_mm + CONTACT_MM


@pytest.mark.parametrize("what", ["done", "no sphere", "no probe"])
def test_the_part_program_goes_on_with_the_tool_that_it_had(what: str) -> None:
    programs = cell()
    programs.machine.present = what != "no sphere"
    programs.lost |= {99} if what == "no probe" else set()
    programs.safe_point()
    assert programs.r[STATE : REASON + 1] == {"done": [3, 0], "no sphere": [5, 6], "no probe": [4, 2]}[what]
    assert (programs.machine.tool, programs.edge) == (3, 2)
    assert programs.machine.at["Z"] >= 300.0, "a tool is changed above everything"


@pytest.mark.parametrize(("r", "value", "reason"), [(61, 7.0, 4), (60, 0.0, 0), (64, 7.0, 0)])
def test_what_is_withdrawn_answered_or_not_asked_moves_nothing(r: int, value: float, reason: int) -> None:
    programs = cell()
    programs.r[r] = value
    before = dict(programs.machine.at)
    programs.safe_point()
    assert programs.machine.at == before
    assert programs.r[REASON] == reason


def test_the_machine_of_these_tests_knows_sphere_and_table() -> None:
    machine = ProbedMachine((120.0, 0.0, 80.0), TABLE_MM, CONTACT_MM)
    machine.move({"X": 120.0, "Y": 0.0})
    assert machine.move({"Z": 0.0}, touching=True)
    assert machine.at["Z"] == pytest.approx(80.0 + CONTACT_MM)
    assert math.isclose(machine.centre(90.0, 0.0)[1], -80.0)
