"""What the probing programs for a SINUMERIK do, run by an interpreter, judged by what the axes do."""

from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from drivers.sinumerik.handshake import PROBING_REASONS
from drivers.sinumerik.settings import Handshake
from simulators.nc.synchronised import ProgramAlarm
from tests.benches import nc_starts
from tests.benches.nc_cases import CASES, jogged_at, jogged_within, reset_at, stuck_at
from tests.benches.nc_deleted import missed_by, statements
from tests.benches.probed_workshop import CONTACT_MM, Workshop, on_table
from tests.benches.probing_programs import (
    FOLDER,
    IDEAL,
    NOMINAL,
    POSES,
    PROBING,
    SAFE_Z,
    Cell,
    Intended,
    off_the_way,
    program_texts,
    reported,
    started_at,
    unsafe,
)
from tests.benches.watchdog_programs import WATCHDOG_CASES, Control, run_at_power_on, watchdog_texts

HAND = Handshake()


@pytest.mark.parametrize(
    "case", [pytest.param(case, marks=[pytest.mark.slow] * (i % 4 > 0)) for i, case in enumerate(CASES)]
)
def test_whatever_happens_it_ends_as_it_has_to(case: str) -> None:
    assert CASES[case](program_texts()) == []


def test_from_mixed_states_of_the_control_nothing_goes_otherwise_than_it_has_to() -> None:
    """600 of them: python -m tests.benches.nc_starts."""
    for state in islice(nc_starts.states(400), 120, None, 35):
        assert nc_starts.run(state)[1] == [], state


def test_no_state_comes_without_its_number_and_the_offsets_are_let_go_where_they_were_frozen() -> None:
    cell = Cell()
    cell.r[64:68] = [6.0, 3.0, 0.0, 6.0]
    cell.safe_point()
    answer = [
        (HAND.state, 0),
        (HAND.result_of, 0),
        (HAND.answers, 7),
        (HAND.reason, 0),
        (HAND.state, 1),
        (HAND.state, 2),
    ]
    written = reported(cell)
    assert written[:6] == answer
    results = range(HAND.results, HAND.results + 3 * len(POSES))
    assert [number for number, _ in written[6 : 6 + len(results) + 1]] == [*results, HAND.spread]
    assert written[-4:] == [(HAND.state, 1), (HAND.reason, 0), (HAND.result_of, 7), (HAND.state, 3)]
    _, accepted, frozen, let_go, done = (at for number, _, at, _ in cell.channel.written if number == HAND.state)
    over = IDEAL.taught(*NOMINAL.poses_deg[0])[:2]
    assert [frozen[axis] for axis in "XYZ"] == pytest.approx([*over, SAFE_Z])
    assert accepted != frozen
    assert [let_go[axis] for axis in "XYZA"] == [frozen[axis] for axis in "XYZA"]
    assert (let_go["C"] - frozen["C"]) % 360.0 == pytest.approx(0.0)
    assert (let_go["T"], done["T"]) == (99.0, 3.0), "the last state comes with the tool of the part program"


def test_every_reason_that_a_program_gives_has_a_text() -> None:
    given = {1, 2, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18}
    assert given <= {code for code, text in PROBING_REASONS.items() if text}
    assert len(set(PROBING_REASONS.values())) == len(PROBING_REASONS)


@pytest.mark.slow
def test_a_statement_that_is_deleted_is_missed() -> None:
    """All of them: python -m tests.benches.nc_deleted."""
    texts = program_texts()
    found = [deleted for deleted in statements(texts) if "MEAS" in deleted.block or deleted.block == "SPOS=0"]
    assert len(found) == 4
    for deleted in found:
        assert missed_by(deleted, texts, ["from a usual machine"]) is not None, deleted
    texts = watchdog_texts()
    for deleted in list(statements(texts))[::7]:
        cases = WATCHDOG_CASES[deleted.program]
        assert missed_by(deleted, texts, list(cases), cases) is not None, deleted


@pytest.mark.slow(minutes=1)
@pytest.mark.parametrize("at", range(0, 500, 123))
def test_at_any_move_a_reset_a_hand_and_a_stuck_probe_make_the_cycle_void(at: int) -> None:
    texts = program_texts()
    usual = Cell(texts=texts)
    usual.safe_point()
    assert reset_at(texts, at) == []
    assert jogged_at(texts, at) == []
    assert stuck_at(texts, next(n for n in range(at, at + 9) if not usual.moves[n].met)) == []
    assert jogged_within(texts, next(n for n in range(at, at + 9) if usual.moves[n].met)) == []


@pytest.mark.slow
@pytest.mark.parametrize("program", WATCHDOG_CASES)
def test_the_watchdog_s_programs_start_from_any_state_leave_it_and_watch(program: str) -> None:
    """From 620 of them: python -m tests.benches.watchdog_programs."""
    texts = watchdog_texts()
    for state in islice(nc_starts.states(200), 0, None, 11):
        assert run_at_power_on(state, program, texts)[1] == [], state
    for case in WATCHDOG_CASES[program].values():
        assert case(texts) == []


@pytest.mark.parametrize("program", ["START", "ERRORS"])
def test_after_power_off_the_next_request_runs(program: str) -> None:
    control = Control(nc_starts.USUAL, watchdog_texts())
    control.call(f"TALC_{program}")
    cell = control.cell
    cell.safe_point()
    assert (cell.moves, cell.r[64:67]) == ([], [7.0, 4.0, 4.0]), "what was asked before is withdrawn"
    cell.r[60] = 8.0
    cell.safe_point()
    assert (cell.r[65], cell.r[89]) == (3.0, 2.0)


def test_a_sphere_program_from_before_dry_runs_does_not_fit_the_others() -> None:
    """It has no height: in a dry run it would touch."""
    older = "PROC TALC_SPHERE(INT TALC_POSE) DISPLOF\nSUPA G1 Z=100 F=200\nRET"
    with pytest.raises(ProgramAlarm, match="TALC_SPHERE"):
        Cell(texts=program_texts() | {"SPHERE": older}).safe_point()


def test_the_judge_s_geometry_is_the_machine_s() -> None:
    """The table's own view of the probe, at random positions, against rotation matrices."""
    draw = np.random.default_rng(3)
    for x, y, z, a, c in draw.uniform((-200, -200, 150, -90, 0), (200, 200, 400, 90, 360), (20, 5)):
        ra, rc = np.deg2rad(a), np.deg2rad(c)
        about_x = np.array([[1, 0, 0], [0, np.cos(ra), -np.sin(ra)], [0, np.sin(ra), np.cos(ra)]])
        about_z = np.array([[np.cos(rc), -np.sin(rc), 0], [np.sin(rc), np.cos(rc), 0], [0, 0, 1]])
        seen = on_table(np.array([[x, y, z, a, c]]))[0]
        assert about_x @ about_z @ seen == pytest.approx([x, y, z - 150.0])
    workshop = Workshop((120.0, 0.0, 80.0))
    for a, c in ((0.0, 0.0), (90.0, 0.0), (-90.0, 0.0), (30.0, 200.0)):
        place = np.array([[*workshop.taught(a, c), a, c]])
        assert workshop.gap(place + np.array([0.0, 0.0, CONTACT_MM, 0.0, 0.0]))[0] == pytest.approx(0.0, abs=1e-9)


def test_the_judge_sees_a_way_that_is_wrong() -> None:
    cell = Cell()
    start = started_at(cell)
    cell.safe_point()
    assert off_the_way(cell, start) == []
    assert len(list(Intended(cell, start).places())) == len(cell.moves)
    assert off_the_way(cell, start, raised=50.0)
    assert unsafe(cell, raised=200.0), "a move below the height of a dry run"
    lower = Cell(data={"TALC_CLEAR_MM": -14.0})
    lower.safe_point()
    assert off_the_way(lower, start)


def test_all_programs_are_here() -> None:
    assert {f"TALC_{name}.SPF" for name in PROBING} | {"TALC_START.SPF", "TALC_SLOPES.SPF"} == {
        path.name for path in Path(FOLDER).glob("*.SPF")
    }
