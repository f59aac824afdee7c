"""The interpreter of part programs: values and types, order, what each state makes of a block, and refusals."""

import numpy as np
import pytest

from simulators.nc.axes import Axes
from simulators.nc.channel import Channel
from simulators.nc.synchronised import ProgramAlarm
from simulators.nc.tools import Tools

DATA = """%_N_MGUD_DEF
;$PATH=/_N_DEF_DIR
DEF CHAN REAL TALC_LIST[3] = SET(1, 2.5, -3)
DEF CHAN INT TALC_WHOLE = 7
DEF CHAN BOOL TALC_TRUE = 2
DEF CHAN REAL TALC_REAL
M30
"""
WALL_MM = 50.0


def channel(*programs: str, ahead: int = 1000) -> Channel:
    """A machine with a wall at X = 50 in front of the probe, without a tool."""
    axes = Axes(
        {"X": 0.0, "Y": 0.0, "Z": 0.0, "A": 0.0, "C": 350.0},
        {"X": (-999.0, 999.0), "Y": (-999.0, 999.0), "Z": (-99.0, 999.0), "A": (-120.0, 120.0), "C": (-1e6, 1e6)},
        lambda positions: WALL_MM - positions[:, 0],
        probe_on=True,
    )
    made = Channel(programs, DATA, axes, Tools(axes, {0: 0.0, 3: 100.0, 7: 80.0}), ahead=ahead)
    for code in ("G71", "G94", "G90"):
        made.modal.switch(code)
    made.feed = 600.0
    return made


def program(*blocks: str, head: str = "PROC TALC_ONE DISPLOF") -> str:
    return "\n".join([head, *blocks, "RET"])


def run(*blocks: str, others: tuple[str, ...] = ()) -> Channel:
    made = channel(program(*blocks), *others)
    made.start("TALC_ONE")
    return made


@pytest.mark.parametrize(
    ("expression", "value"),
    [
        ("1 + 2 * 3 - 4 / 8", 6.5),
        ("2 - 3 - 4", -5.0),
        ("-2 * -3", 6.0),
        ("ROUND(2.5) + ROUND(-0.6)", 2.0),
        ("MAXVAL(TALC_LIST[1], ABS(TALC_LIST[2]))", 3.0),
        ("SIN(30)", 0.5),
        ("TALC_WHOLE B_AND 5", 5.0),
        ("TALC_WHOLE / 2", 3.5),
    ],
)
def test_an_expression_has_its_value(expression: str, value: float) -> None:
    assert run(f"R1 = {expression}").r[1] == pytest.approx(value)


@pytest.mark.parametrize(
    ("condition", "truth"),
    [
        ("0.1 + 0.2 == 0.3", True),
        ("0.1 + 0.2 <> 0.3", False),
        ("1 + 1 > 1", True),
        ("NOT TALC_TRUE OR TALC_TRUE", True),
        ("(1 > 2) OR (2 > 1) AND (3 > 4)", False),
        ("TALC_TRUE", True),
    ],
)
def test_a_condition_is_true_by_the_manual_s_priorities(condition: str, truth: bool) -> None:
    assert run(f"IF {condition}", "R1 = 1", "ELSE", "R1 = 2", "ENDIF").r[1] == (1.0 if truth else 2.0)


def test_assigning_converts() -> None:
    made = run("TALC_WHOLE = 2.5", "TALC_TRUE = 0.1", "TALC_REAL = TALC_WHOLE / 2")
    assert [made.data(name) for name in ("TALC_WHOLE", "TALC_TRUE", "TALC_REAL")] == [[3], [True], [1.5]]


def test_loops_and_jumps_go_where_they_say() -> None:
    made = run(
        "FOR TALC_WHOLE = 2 TO 4", "R1 = R1 + TALC_WHOLE",
        "IF TALC_WHOLE == 3", "GOTOF TALC_OUT", "ENDIF", "ENDFOR", "R2 = 1", "TALC_OUT:", "R3 = 1",
    )  # fmt: skip
    assert made.r[1:4] == [5.0, 0.0, 1.0]


def test_a_program_has_its_own_data_and_gives_no_value_back() -> None:
    called = program("TALC_IN = TALC_IN + 1", "R2 = TALC_IN", head="PROC TALC_TWO(INT TALC_IN) DISPLOF")
    made = run("EXTERN TALC_TWO(INT)", "DEF INT TALC_IN = 5", "TALC_TWO(TALC_IN)", "R1 = TALC_IN", others=(called,))
    assert made.r[1:3] == [5.0, 6.0]


def test_g_functions_outlast_a_program_unless_it_saves_them_and_f_does_not() -> None:
    two = program("G60 G93", "F=5", head="PROC TALC_TWO SAVE DISPLOF")
    three = program("G60", head="PROC TALC_THREE DISPLOF")
    made = channel(program("TALC_TWO"), two, three, program("TALC_THREE", head="PROC TALC_FOUR DISPLOF"))
    made.modal.switch("G641")
    made.start("TALC_ONE")
    assert (made.modal.codes[10], made.modal.codes[15], made.feed) == ("G641", "G94", 0.0)
    made.start("TALC_FOUR")
    assert made.modal.codes[10] == "G60"


def test_what_is_read_before_the_axes_are_there_is_old() -> None:
    ahead = run("G1", "SUPA X=10 F=600", "R1 = $AA_IM[X]", "STOPRE", "R2 = $AA_IM[X]")
    assert ahead.r[1:3] == [0.0, 10.0]
    single = channel(program("G1", "SUPA X=10", "R1 = $AA_IM[X]"), ahead=0)
    single.start("TALC_ONE")
    assert single.r[1] == 10.0


@pytest.mark.parametrize(
    ("states", "blocks", "end"),
    [
        ((), "SUPA G1 X=10", {"X": 10.0}),
        (("G70",), "SUPA G1 X=1 Y=2", {"X": 25.4, "Y": 50.8}),
        (("G700",), "SUPA G1 Z=1", {"Z": 25.4}),
        (("G91",), "SUPA G1 X=10\nSUPA G1 X=10", {"X": 20.0}),
        (("DIAMON",), "SUPA G1 X=10 Y=10", {"X": 5.0, "Y": 10.0}),
        (("G54",), "G1 X=10", {"X": 11.0}),
        (("G54",), "SUPA G1 X=10", {"X": 10.0}),
        (("G54",), "G1 C=10", {"C": 15.0}),
        (("G54",), "SUPA G1 C=10", {"C": 10.0}),
        ((), "SUPA G1 C=DC(10)", {"C": 370.0}),
        ((), "SUPA G1 C=DC(200)", {"C": 200.0}),
    ],
)
def test_a_block_goes_where_the_states_in_force_make_it_go(
    states: tuple[str, ...], blocks: str, end: dict[str, float]
) -> None:
    made = channel(program(blocks))
    made.frames.settable = {"G54": (1.0, 0.0, 0.0, 0.0, 5.0)}
    for code in states:
        made.modal.switch(code)
    made.start("TALC_ONE")
    assert {axis: made.axes.position[axis] for axis in end} == pytest.approx(end)


def test_a_tool_s_length_counts_with_supa_unless_the_machine_data_says_otherwise() -> None:
    ends = []
    for stays in (True, False):
        made = channel(program("SUPA G1 Z=10", "D0", "SUPA G1 Y=1 Z=20"))
        made.told.length_stays = stays
        made.tools.begin(3, 1, 0, 3)
        made.start("TALC_ONE")
        ends.append([move.path[-1, 2] for move in made.axes.moves])
    assert ends == [[110.0, 20.0], [10.0, 20.0]]


def test_a_measuring_block_ends_where_the_probe_switches_and_latches_it() -> None:
    made = run(
        "MEAS=1 SUPA G1 X=100 F=600", "STOPRE", "R1 = $AA_MM[X] R2 = $AA_IM[X]", "IF $AC_MEA[1] == 1", "R3 = 1", "ENDIF"
    )
    assert made.r[1] == pytest.approx(WALL_MM, abs=1e-6)
    assert made.r[2] == pytest.approx(WALL_MM + 10.0 * 0.01 + 10.0**2 / 2000.0)
    assert made.r[3] == 1.0
    assert np.max(np.abs(np.diff(made.axes.moves[0].path, axis=0))) <= 0.5 + 1e-9


def test_corners_are_rounded_unless_an_exact_stop_is_in_force() -> None:
    corner = ("SUPA G1 X=20", "SUPA G1 Y=20")
    assert run("G60 G601", *corner).axes.moves[0].path[-1, 0] == 20.0
    made = channel(program(*corner))
    made.modal.switch("G64")
    made.start("TALC_ONE")
    assert made.axes.moves[0].path[-1, 0] < 20.0


@pytest.mark.parametrize(
    ("default", "managed", "after", "number"),
    [(1, False, 1, 7), (-1, False, 2, 7), (0, False, 0, 0), (-2, False, 2, 3), (-2, True, 2, 3)],
)
def test_the_edge_after_a_change_and_what_the_control_says_of_the_tool(
    default: int, managed: bool, after: int, number: int
) -> None:
    made = channel(program("T=7", "M6", "STOPRE", "R1 = $P_TOOL R2 = $P_TOOLNO"))
    made.tools.default, made.tools.managed = default, managed
    made.tools.begin(3, 2, 0, 3)
    made.start("TALC_ONE")
    assert (made.axes.tool, made.r[1], made.r[2]) == (7, after, number)


def test_with_a_magazine_the_tool_in_the_spindle_is_asked_for() -> None:
    made = channel(program("DEF INT TALC_TOOL", "T=7", "M6", "STOPRE", "GETEXET(TALC_TOOL)", "R1 = TALC_TOOL"))
    made.tools.managed = True
    made.start("TALC_ONE")
    assert made.r[1] == 7.0


def test_in_a_search_nothing_moves_but_assignments_run() -> None:
    made = channel(program("SUPA G1 X=10", "STOPRE", "R1 = 1"))
    made.told.search = True
    made.start("TALC_ONE")
    assert (made.axes.moves, made.r[1]) == ([], 1.0)


@pytest.mark.parametrize(
    ("blocks", "cause"),
    [
        (["DEF INT NUMBER"], "NUMBER: has a meaning"),
        (["DEF REAL X2"], "X2: the first two characters"),
        (["DEF INT TALC_A234567890123456789012345678"], "at most 31"),
        (["DEF INT TALC_ONE, TALC_ONE"], "defined twice"),
        (["DEF INT TALC_WHOLE"], "TALC_WHOLE is global data too"),
        (["R1 = TALC_UNKNOWN"], "TALC_UNKNOWN is not defined"),
        (["R1 = MINVAL(1, 2)"], "MINVAL: not a function"),
        (["G2 X=1"], "G2: not known here"),
        (["M10"], "M10: not known here"),
        (["MEAW=1 G1 X=1"], "cannot be written|not known|expected|not defined"),
        (["X=1 X=2"], "an address twice"),
        (["TALC_TWO(1)"], "no EXTERN with 1"),
        (["EXTERN TALC_TWO(INT)", "TALC_TWO(1)"], "EXTERN TALC_TWO does not fit"),
        (["IF 1 == 1", "R1 = 1"], "expected ENDIF"),
        (["R1 = (1 == 1) == 1 == 1"], "a comparison of a comparison"),
        (["MSG(1)"], "expected a text"),
        (["R1 = 1 ?"], "cannot read"),
        (["$$R[1] = 1"], "only synchronised actions"),
        ([f"R1 = {' + '.join(['1'] * 200)}"], "at most 512"),
    ],
)
def test_a_program_that_a_control_would_not_take_is_refused_when_it_is_read(blocks: list[str], cause: str) -> None:
    with pytest.raises(ProgramAlarm, match=cause):
        channel(program(*blocks))


@pytest.mark.parametrize(
    ("blocks", "cause"),
    [
        (["IF 1", "ENDIF"], "the condition is a number"),
        (["IF (1 > 0) AND 1", "ENDIF"], "expected a truth value"),
        (["R1 = 1 / 0"], "division by 0"),
        (["R1 = TALC_LIST[3]"], "the control has none"),
        (["R1 = $P_UNKNOWN"], "not known"),
        (["R1 = $P_GG[99]"], "not known here"),
        (["$AA_IM[X] = 1"], "not known"),
        (["TALC_NONE"], "no such program"),
        (["GOTOF TALC_NONE"], "not further on"),
        (["F=0"], "14800"),
        (["G1 X=1000"], "10720"),
        (["T=55"], "T55: not known"),
        (["GETEXET(TALC_WHOLE)"], "no magazine management"),
        (["G1 MEAS=1 SUPA X=0"], "without a motion"),
        (["G1 SUPA X=60", "MEAS=1 SUPA X=70"], "21700"),
        (["G1 A=DC(10)"], "DC is for modulo axes"),
        (["X=1"], "a motion with G0"),
        (["IDS=1 DO $R[1] = 1"], "no synchronised actions"),
        (["TALC_ONE"], "program levels"),
    ],
)
def test_what_stops_a_control_stops_the_interpreter_with_its_line(blocks: list[str], cause: str) -> None:
    with pytest.raises(ProgramAlarm, match=rf"TALC_ONE line \d+: .*{cause}"):
        run(*blocks)


@pytest.mark.parametrize(
    ("data", "cause"),
    [
        (DATA.replace("M30\n", ""), "M30"),
        (DATA.replace("%_N_MGUD_DEF", ""), "line 1"),
        (DATA.replace("TALC_WHOLE", "TALC_TRUE"), "line 5: TALC_TRUE is defined twice"),
        (DATA.replace("SET(1, 2.5, -3)", "SET(1, 2)"), "line 3: TALC_LIST: 2 values for 3"),
    ],
)
def test_global_data_that_a_control_would_not_take_is_refused(data: str, cause: str) -> None:
    axes = channel().axes
    with pytest.raises(ProgramAlarm, match=cause):
        Channel([], data, axes, Tools(axes, {}))
