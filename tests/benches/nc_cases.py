"""What can happen at a machine while it is probed: each case says what was not as it has to be.

`python -m tests.benches.nc_cases` runs all of them, and RESET, a stop with the axes moved by hand and a probe that
sticks at every move of a cycle.
"""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise, permutations

import numpy as np

from simulators.nc.axes import Reset
from simulators.nc.spindle import NO_FLUID
from simulators.nc.synchronised import ProgramAlarm
from tests.benches import nc_starts
from tests.benches.probed_workshop import CONTACT_MM, Workshop
from tests.benches.probing_programs import (
    CLEARANCE_MM,
    FEEDS,
    IDEAL,
    LIMITS,
    NOMINAL,
    POSES,
    REACH,
    SAFE_Z,
    Cell,
    off_the_way,
    program_texts,
    reported,
    started_at,
    unsafe,
)

Texts = Mapping[str, str]
_SPHERE = Cell().workshop.sphere_mm
_ODD = nc_starts.USUAL | {
    "group 6": "G18", "group 8": "G55", "group 10": "G641", "group 12": "G603", "group 13": "G700", "group 14": "G91",
    "group 15": "G95", "group 29": "DIAMON", "programmable frame": "turned", "sum offset": 2, "preselected": 7,
    "magazine management": True, "Z": SAFE_Z - 200.0, "C": 7310.0,
}  # fmt: skip
"""Everything is otherwise than the programs need it."""
_BARE = nc_starts.USUAL | {
    "edge": 0,
    "edge after a change": -1,
    "sum offset by default": 1,
    "preselected": 7,
    "Z": SAFE_Z,
}
_STATES: dict[str, nc_starts.State] = {
    "a usual machine": nc_starts.USUAL,
    "another state in every respect": _ODD,
    "no edge in force": _BARE,
    "an offset that the edge brings": nc_starts.USUAL
    | {"sum offset by default": 1, "sum offset": 0, "edge after a change": 0},
    "a tool that changes with T": _ODD
    | {"tool change mode": 0, "magazine management": False, "the change moves Z": False},
    "a tool that changes with T, with a magazine": _ODD | {"tool change mode": 0},
    "the probe in the spindle": nc_starts.USUAL | {"tool": 99, "preselected": 3},
    "no feed": nc_starts.USUAL | {"F": 0.0},
    "single block": _ODD | {"blocks ahead": 0},
    "dry run over the sphere": _ODD | {"raised": 20.0},
    "a deflected probe": _ODD | {"deflected": True},
    "old tool's offset": _ODD | {"edge after a change": -2, "old tool's offset": True},
    "old tool's offset with the first edge": _ODD | {"edge after a change": -2, "old tool's offset": True, "edge": 1},
    "old tool's offset without a magazine": nc_starts.USUAL | {"edge after a change": -2, "old tool's offset": True},
    "no edge after a change": nc_starts.USUAL | {"edge after a change": 0, "edge": 0},
    "the spindle turns": nc_starts.USUAL | {"spindle": 3, "cutting fluid": 7, "group of the fluid": 5},
    "the spindle turns backwards": nc_starts.USUAL
    | {"spindle": 4, "speed by": "SVC", "cutting fluid": 8, "group of the fluid": 5},
    "constant cutting speed": nc_starts.USUAL | {"spindle": 4, "group 15": "G96"},
    "constant cutting speed at rest": nc_starts.USUAL | {"group 15": "G96", "cutting fluid": 8},
    **{
        f"the spindle is {what}": nc_starts.USUAL | {"spindle is": what, "speed by": by}
        for by, what in zip(("S", "S", "nothing", "S", "S"), nc_starts.CHOICES["spindle is"][1:], strict=True)
    },
    "the spindle was switched off by hand": nc_starts.USUAL | {"spindle": 3, "spindle is": "switched by hand"},
    "a grinding wheel": nc_starts.USUAL | {"speed by": "a wheel"},
    **{f"control is {what}": nc_starts.USUAL | {"control is": what} for what in nc_starts.CHOICES["control is"][1:]},
    "the table turned back": nc_starts.USUAL | {"A": 0.0, "C": 7310.0},
    "Z ends above the way": nc_starts.USUAL | {"Z goes to": 400.0},
    "Z ends below it": nc_starts.USUAL | {"Z goes to": 400.0, "raised": 50.0, "group 13": "G700"},
    **{
        f"Z ends just above the way, and it is {raised:g} mm higher": nc_starts.USUAL
        | {"Z goes to": SAFE_Z + 10.0, "raised": raised}
        for raised in (20.0, 50.0)
    },
    **{f"axis {axis}": nc_starts.USUAL | {"not referenced": axis, "start lock": False} for axis in "XYZAC"},
    "transformation": nc_starts.USUAL | {"transformation": 24},
    "tool carrier": nc_starts.USUAL | {"tool carrier": 1},
    "compensated contour": nc_starts.USUAL | {"group 7": "G41"},
    "thread": nc_starts.USUAL | {"group 1": "G33"},
    "ISO": nc_starts.USUAL | {"group 47": "G291"},
}


def _answer(cell: Cell, state: int, reason: int) -> Iterator[str]:
    if cell.r[64:68] != [7.0, state, reason, 0.0]:
        yield f"R64 to R67 = {cell.r[64:68]}, expected state {state}, reason {reason}"


def _failed(cell: Cell, reason: int) -> list[str]:
    """Run it: the cycle fails for this reason, the probe is up again, and the part program goes on as before."""
    before = cell.state()
    switched_on = cell.axes.spindle == "turns" or cell.axes.fluid != NO_FLUID
    try:
        cell.safe_point()
    except ProgramAlarm as alarm:
        return [str(alarm)]
    wrong = [*_answer(cell, 5, reason), *unsafe(cell, cell.r[63]), *_not_back(cell)]
    if cell.moves and cell.moves[-1].path[-1, 2] < SAFE_Z + cell.r[63] - 1e-3:
        wrong.append("the probe is left below TALC_SAFE_Z")
    if cell.state() != before:
        wrong.append(f"{before} became {cell.state()}")
    if cell.moves and cell.workshop.gap(cell.moves[-1].path[-1:])[0] < CLEARANCE_MM:
        wrong.append("the probe is left at what it met")
    if cell.axes.probe_on:
        wrong.append("the probe stays switched on")
    if len(cell.halts) != (reason != 4 or switched_on) or not all(cell.halts):
        wrong.append(f"stopped with {cell.halts}: expected unless it was withdrawn and nothing is switched on")
    *_, (_, let_go), (state, ended) = [(value, at) for number, value, at, _ in cell.channel.written if number == 65]
    if let_go["Z"] < SAFE_Z + cell.r[63] - 1e-3:
        wrong.append("the offsets are let go before the probe is up")
    if state != 5.0 or ended["T"] != before["tools"][0]:
        wrong.append("R65 becomes 5 before the tool is back")
    return wrong


def _not_back(cell: Cell) -> Iterator[str]:
    """What was met on the way is left by the way that it came, as fast at most; and the last move does not go down."""
    for move, back in pairwise(cell.moves):
        if move.met and move.feed > FEEDS["touch"] and not np.allclose(back.path[-1], move.path[0], atol=1e-6):
            yield "does not go back where it came from"
        if move.met and back.feed > max(move.feed, FEEDS["way"] * (move.feed <= FEEDS["touch"])):
            yield "goes back faster than it came"
    if cell.moves and not cell.moves[-1].measures and cell.moves[-1].path[-1, 2] < cell.moves[-1].path[0, 2] - 1e-6:
        yield "goes down at the end"


def _not_begun(cell: Cell, state: int, reason: int) -> list[str]:
    before = cell.state()
    cell.safe_point()
    wrong = list(_answer(cell, state, reason)) if state else []
    if cell.moves or cell.state() != before or (state and cell.tools.changes and reason != 2):
        wrong.append("something moved or changed")
    return wrong


def _withdrawn(texts: Texts) -> list[str]:
    cell = Cell(texts=texts)
    cell.r[61] = 7.0
    return _not_begun(cell, 4, 4)


def _expired(texts: Texts) -> list[str]:
    cell = Cell(texts=texts)
    cell.timers[1] = 901.0
    return _not_begun(cell, 4, 5)


def _no_timer(texts: Texts) -> list[str]:
    """TALC_START has not run: how old the request is, nothing tells."""
    cell = Cell(texts=texts)
    cell.timers[1] = 0.0
    return _not_begun(cell, 4, 5)


def _no_limit(texts: Texts) -> list[str]:
    wrong = []
    for age in (0.0, 1e6):
        cell = Cell(texts=texts)
        cell.timers[1], cell.r[62] = age, 0.0
        cell.safe_point()
        wrong += [] if cell.r[65] == 3.0 else [f"a request without a time limit is refused at {age:g} s"]
    return wrong


def _too_low(texts: Texts) -> list[str]:
    wrong = []
    for pose in POSES:
        cell = Cell(texts=texts)
        cell.channel.data("TALC_Z")[pose] = SAFE_Z - 13.0 - 30.0 + 0.1
        wrong += _not_begun(cell, 4, 8)
    return wrong


def _below_zero(texts: Texts) -> list[str]:
    wrong = []
    for height in (-1.0, 19.0):  # at 19 a touch would come down to the sphere's contact
        cell = Cell(texts=texts)
        cell.r[63] = height
        wrong += _not_begun(cell, 4, 15)
    return wrong


def _height_taken_away(texts: Texts) -> list[str]:
    """Another program uses R63: a dry run is asked for, and nothing says how high."""
    cell = Cell(texts=texts)
    cell.r[63], cell.r[89] = 0.0, -1.0
    wrong = _not_begun(cell, 4, 15)
    cell.r[60], cell.r[63], cell.r[89] = 8.0, 50.0, -1.0
    cell.safe_point()
    return [*wrong, *unsafe(cell, 50.0), *(["R65 or R89 is wrong"] if (cell.r[65], cell.r[89]) != (3.0, 2.0) else [])]


def _no_probe(texts: Texts) -> list[str]:
    wrong = []
    for managed in (False, True):
        cell = Cell(texts=texts)
        cell.tools.managed, cell.tools.lost = managed, frozenset({99})
        wrong += _not_begun(cell, 4, 2)
    return wrong


def _loaded_by_hand(texts: Texts) -> list[str]:
    """Where T changes the tool: a tool that was programmed before this one was put in is not fetched again."""
    cell = Cell(texts=texts)
    cell.tools.mode = 0
    cell.tools.begin(3, 1, 0, preselected=7)
    cell.safe_point()
    return [] if (cell.r[65], cell.axes.tool) == (3.0, 3) else [f"R65 {cell.r[65]:g}, tool {cell.axes.tool}"]


def _nobody(texts: Texts) -> list[str]:
    wrong = []
    for request, answered in ((0.0, 6.0), (7.0, 7.0)):
        cell = Cell(texts=texts)
        cell.r[60], cell.r[64], cell.r[65] = request, answered, 3.0
        wrong += [*_not_begun(cell, 0, 0), *(["written"] if reported(cell) else [])]
        wrong += ["R89 does not tell the version"] * (cell.r[89] != 2.0)
    return wrong


def _no_sphere(texts: Texts) -> list[str]:
    return _failed(Cell(replace(Cell().workshop, present=False), texts), 6)


def _switched_on(cell: Cell) -> Cell:
    """The part program calls with spindle and cutting fluid on."""
    spindle = cell.channel.spindle
    spindle.direction, spindle.s = 3, {1: 800.0}
    spindle.switch(3)
    spindle.wait()
    spindle.fluid, cell.channel.data("TALC_FLUID_GROUP")[0] = 8, 5
    return cell


def _no_sphere_switched_on(texts: Texts) -> list[str]:
    """Spindle and fluid are switched on again after NC start, not before."""
    return _failed(_switched_on(Cell(replace(Cell().workshop, present=False), texts)), 6)


def _no_probe_switched_on(texts: Texts) -> list[str]:
    cell = _switched_on(Cell(texts=texts))
    cell.tools.managed, cell.tools.lost = True, frozenset({99})
    return _not_begun(cell, 4, 2)


def _withdrawn_switched_on(texts: Texts) -> list[str]:
    wrong = []
    for fluid, direction in ((9, 3), (9, 4), (7, 5), (8, 5)):
        cell = _switched_on(Cell(texts=texts))
        cell.channel.spindle.direction = direction
        cell.channel.spindle.switch(direction)
        cell.channel.spindle.wait()
        cell.axes.fluid = fluid
        wrong += _withdrawn_in(cell, 4)
    cell = Cell(texts=texts)
    cell.channel.spindle.direction = 3
    cell.channel.spindle.turn_to(123.0)  # it goes back there without being switched on
    return [*wrong, *_withdrawn_in(cell, 4)]


def _alarm_later(texts: Texts) -> list[str]:
    """One that stops something comes while the block before the call still moves."""
    wrong = []
    for bit in (0x04, 0x11, 0x40, 0x2000):
        cell = _called_after_a_move(texts)

        def before(_: int, cell: Cell = cell, bit: int = bit) -> None:
            cell.channel.told.alarm = bit | 0x200

        cell.axes.before = before
        cell.channel.start("PART_PROGRAM")
        wrong += [*_answer(cell, 4, 1), *(["moves"] if len(cell.moves) > 1 else [])]
    return wrong


def _beyond_travel(texts: Texts) -> list[str]:
    """Each end of each axis, a little too near and just far enough; C has none."""
    room, wrong = CONTACT_MM + 2 * REACH, list[str]()
    taught = np.array([IDEAL.taught(*pose) for pose in NOMINAL.poses_deg])
    angles = [a for a, _ in NOMINAL.poses_deg]
    ends: dict[str, tuple[float, float]] = {
        "X": (taught[:, 0].min() - room, taught[:, 0].max() + room),
        "Y": (taught[:, 1].min() - room, taught[:, 1].max() + room),
        "Z": (taught[:, 2].min() - REACH, SAFE_Z),
        "A": (min(angles), max(angles)),
    }
    ends = {axis: (float(low), float(high)) for axis, (low, high) in ends.items()}
    for axis, (low, high) in ends.items():
        for near in ((low + 0.1, LIMITS[axis][1]), (LIMITS[axis][0], high - 0.1)):
            cell = Cell(texts=texts)
            cell.axes.limits = {**LIMITS, axis: near}
            wrong += [f"{axis} {near}: {fault}" for fault in _not_begun(cell, 4, 18)]
    cell = Cell(texts=texts)
    cell.axes.limits = {**LIMITS, **{axis: (low - 1e-6, high + 1e-6) for axis, (low, high) in ends.items()}}
    wrong += _done_within_travel(cell)
    cell = Cell(texts=texts)
    cell.r[63] = 50.0  # so much higher is the lower end of Z needed too
    cell.axes.limits = {**LIMITS, "Z": (ends["Z"][0] + 50.0 - 1e-6, LIMITS["Z"][1])}
    return [*wrong, *_done_within_travel(cell)]


def _done_within_travel(cell: Cell) -> Iterator[str]:
    cell.axes.position.update(Y=0.0, Z=SAFE_Z + cell.r[63])
    cell.tools.change_height = None
    cell.safe_point()
    if cell.r[65] != 3.0:
        yield f"refused within its travel: R66 = {cell.r[66]:g}"


def _found_too_high(texts: Texts) -> list[str]:
    """Between its touches the probe goes as much higher as the sphere is found: here higher than TALC_SAFE_Z."""
    wrong = []
    highest = max(float(IDEAL.taught(*pose)[2]) for pose in NOMINAL.poses_deg)
    for raised, needed in ((0.0, SAFE_Z + REACH), (20.0, SAFE_Z + 20.0 + REACH)):
        for room, ended in ((-0.1, [7.0, 4.0, 18.0]), (1e-6, [7.0, 3.0, 0.0])):
            cell = Cell(texts=texts, data={"TALC_CLEAR_MM": SAFE_Z - CONTACT_MM - highest})
            cell.r[63], cell.axes.limits = raised, {**LIMITS, "Z": (LIMITS["Z"][0], needed + room)}
            cell.axes.position["Z"], cell.tools.change_height = SAFE_Z, None
            cell.safe_point()
            if cell.r[64:67] != ended or bool(cell.moves) is (room < 0.0):
                wrong.append(f"Z to {needed + room:g}, {raised:g} mm higher: {cell.r[64:67]}, {len(cell.moves)} moves")
    return wrong


def _moved_sphere(texts: Texts) -> list[str]:
    """The first way down beside it meets it."""
    return _failed(Cell(Workshop((_SPHERE[0] + 16.0, 0.0, _SPHERE[2])), texts), 11)


def _post(texts: Texts) -> list[str]:
    """It meets the probe when the table turns to the second pose."""
    return _failed(Cell(Workshop(_SPHERE, post_mm=(85.0, -85.0, 305.0)), texts), 11)


def _post_on_the_way(texts: Texts) -> list[str]:
    """It meets the probe before it is over the sphere: no offset has been frozen."""
    cell = Cell(Workshop(_SPHERE, post_mm=(75.0, -20.0, 505.0)), texts)
    cell.axes.position["A"] = 0.0
    return [*_failed(cell, 11), *(["R65 was 2"] if (65, 2.0) in reported(cell) else [])]


def _other_turns(texts: Texts) -> list[str]:
    """C has turned often, and its poses are entered as other turns of the same angles."""
    wrong = []
    for turns, stands in (
        ((0.0, -270.0, -180.0, 630.0, -1e-7, 360.0), -3600.0),
        ((0.0, 90.0, 180.0, 270.0, 720.0, 0.0), 1e6),
    ):
        cell = Cell(texts=texts)
        cell.channel.data("TALC_C")[:], cell.axes.position["C"] = turns, stands
        start = started_at(cell)
        cell.safe_point()
        wrong += [*off_the_way(cell, start), *unsafe(cell), *(["R65 is not 3"] if cell.r[65] != 3.0 else [])]
    for stands in (-720.0, -1e-7):
        cell = Cell(Workshop(_SPHERE, post_mm=(85.0, -85.0, 305.0)), texts)
        cell.channel.data("TALC_C")[0] = stands
        wrong += _failed(cell, 11)
    cell = Cell(Workshop(_SPHERE, post_mm=(75.0, -20.0, 305.0)), texts)
    cell.axes.position.update(X=63.6, Y=-44.5, Z=SAFE_Z, A=0.0, C=-400.0)
    cell.tools.change_height = None
    return [*wrong, *_failed(cell, 11)]


def _met_in_dry_run(texts: Texts) -> list[str]:
    """The sphere is as much higher as the whole way: a touch meets it."""
    cell = Cell(Workshop((_SPHERE[0], _SPHERE[1], _SPHERE[2] + 50.0)), texts)
    cell.r[63] = 50.0
    return _failed(cell, 11)


def withdrawn_at(texts: Texts, at: int) -> list[str]:
    """Withdrawn within a move: after it, and after the way back from what it met, it goes up only."""
    return _withdrawn_in(Cell(texts=texts), at)


def _withdrawn_in(cell: Cell, at: int) -> list[str]:
    def before(number: int) -> None:
        cell.r[61] = 7.0 if number == at else cell.r[61]

    cell.axes.before = before
    wrong = _failed(cell, 4)
    back = any(move.met for move in cell.moves[at : at + 1])
    return [*wrong, *(["went on"] if len(cell.moves) > at + 2 + back else [])]


def _withdrawn_while_another_asks(texts: Texts) -> list[str]:
    """What is withdrawn is the request that the cycle answers, whatever stands in R60 meanwhile."""
    wrong = []
    for asked, withdrawn, ended in ((8.0, 7.0, (5.0, 4.0)), (8.0, 8.0, (3.0, 0.0))):
        cell = Cell(texts=texts)

        def before(number: int, cell: Cell = cell, asked: float = asked, withdrawn: float = withdrawn) -> None:
            if number == 7:
                cell.r[60], cell.r[61] = asked, withdrawn

        cell.axes.before = before
        cell.safe_point()
        if cell.r[64] != 7.0 or tuple(cell.r[65:67]) != ended:
            wrong.append(f"R60 = {asked:g}, R61 = {withdrawn:g}: R64 to R66 = {cell.r[64:67]}, not {ended}")
    return wrong


def _height_changed(texts: Texts) -> list[str]:
    """Another program writes R63 while the probe is changed in: the cycle keeps the height that was tested."""
    cell = Cell(texts=texts)

    class Changes(list[int]):
        def append(self, tool: int) -> None:
            super().append(tool)
            cell.r[63] = -20.0

    cell.tools.changes = Changes()
    start = started_at(cell)
    cell.safe_point()
    return [*off_the_way(cell, start), *unsafe(cell)]


def _called_after_a_move(texts: Texts) -> Cell:
    cell = Cell(texts={**texts, "part": "PROC PART_PROGRAM DISPLOF\nSUPA G1 Y=-60 F=1000\nTALC_SAFE_POINT\nRET"})
    cell.channel.modal.switch("G94")
    return cell


def _asked_late(texts: Texts) -> list[str]:
    """The request comes while the block before the call still moves."""
    cell = _called_after_a_move(texts)
    cell.r[60] = 0.0

    def before(_: int) -> None:
        cell.r[60] = 7.0

    cell.axes.before = before
    cell.channel.start("PART_PROGRAM")
    return [] if cell.r[65] == 3.0 else ["the request was not seen"]


def _after_a_failure(texts: Texts) -> list[str]:
    """Of a dry run: nothing of it counts in the next cycle."""
    cell = Cell(texts=texts, data={"TALC_WHY": 11, "TALC_SPREAD": 5.0, "TALC_RAISE": 50.0, "TALC_SPEED": 1.0})
    start = started_at(cell)
    cell.safe_point()
    wrong = [*off_the_way(cell, start), *unsafe(cell)]
    return [*wrong, *(["R65 or R88 is wrong"] if cell.r[65] != 3.0 or cell.r[88] > 0.01 else [])]


def _withdrawn_after_a_failure(texts: Texts) -> list[str]:
    """The answer is why it failed, not that it was withdrawn too."""
    cell = Cell(replace(Cell().workshop, present=False), texts)

    def before(number: int) -> None:
        cell.r[61] = 7.0 if number == 5 else cell.r[61]

    cell.axes.before = before
    return _failed(cell, 6)


def reset_at(texts: Texts, at: int) -> list[str]:
    """RESET at a move: the control's hook reports a cycle that was stopped, and no result."""
    cell = Cell(texts=texts)

    def before(number: int) -> None:
        if number == at:
            raise Reset

    cell.axes.before = before
    try:
        cell.safe_point()
    except Reset:
        cell.channel.reset()
        return [*_answer(cell, 5, 7), *unsafe(cell)]
    return ["RESET was not seen"]


def _unreported(texts: Texts) -> list[str]:
    """RESET where no hook tells of it: the next call does, and the next request is obeyed."""
    wrong = []
    for state in (1.0, 2.0):
        cell = Cell(texts=texts)
        cell.r[64:68] = [7.0, state, 0.0, 0.0]
        wrong += _not_begun(cell, 5, 7)
        cell.r[60] = 8.0
        cell.safe_point()
        wrong += [] if cell.r[64:68] == [8.0, 3.0, 0.0, 8.0] else [f"R64 to R67 = {cell.r[64:68]}"]
    return wrong


def _reset_later(texts: Texts) -> list[str]:
    """RESET after a cycle leaves its result alone."""
    cell = Cell(texts=texts)
    cell.r[64:68] = [7.0, 3.0, 0.0, 7.0]
    cell.channel.reset()
    return [] if cell.r[64:68] == [7.0, 3.0, 0.0, 7.0] else ["RESET changed an answer"]


def _loose_sphere(texts: Texts) -> list[str]:
    """It is elsewhere when the third round at the first pose begins: R88 says by how much."""
    wrong = []
    for axis, way in ((0, 0.05), (0, -0.05), (1, -0.05), (2, -0.05)):
        cell = Cell(texts=texts)

        def before(number: int, cell: Cell = cell, axis: int = axis, way: float = way) -> None:
            if number == 63:
                moved = list(_SPHERE)
                moved[axis] += way
                cell.workshop.sphere_mm = (moved[0], moved[1], moved[2])

        cell.axes.before = before
        cell.safe_point()
        if cell.r[65] != 3.0 or abs(cell.r[88] - 0.05) > 0.002:
            wrong.append(f"moved by {way} in {'XYZ'[axis]}: R88 = {cell.r[88]:g}")
    return wrong


def pushed_at(texts: Texts, at: int) -> list[str]:
    """The same with one axis, in each direction."""
    return [fault for axis in "XYZAC" for way in (0.5, -0.5) for fault in jogged_at(texts, at, {axis: way})]


def jogged_at(texts: Texts, at: int, by: Mapping[str, float] | None = None) -> list[str]:
    """Stopped after a move, moved by hand (up, unless told otherwise), and started again: failed, and only up."""
    cell = Cell(texts=texts)
    moves = list[int]()

    def after(number: int) -> None:
        if number == at and not moves:
            moves.append(number)
            for axis, way in (by or {"Z": 1.5}).items():
                cell.axes.position[axis] += way

    cell.axes.after = after
    wrong = _failed(cell, 12)
    for move in cell.moves[at + 1 :]:
        along = move.path[-1] - move.path[0]
        if np.abs(np.delete(along, 2)).max() > 1e-9 or along[2] < 0.0:
            wrong.append("an axis that was moved by hand goes elsewhere than up")
    return wrong


def jogged_within(texts: Texts, at: int) -> list[str]:
    """Stopped within a touch and moved aside by hand: what it then meets does not count.

    Moved along the touch's own way it meets the same point as before: that counts. So does a contact that came first.
    """
    wrong = []
    for aside in ({"Y": 1.0, "X": 1.0, "Z": 2.0}, {"Z": 2.0}, {"Y": 2.0, "X": 2.0}):
        cell = Cell(texts=texts)
        cell.axes.jogged[at] = aside
        faults = _failed(cell, 12)
        path = cell.moves[at].path
        first = np.abs(path[1] - path[0])
        across = [n for n, axis in enumerate("XYZ") if axis in aside and first[n] < 0.1 * np.max(first)]
        if np.any(np.ptp(path[:, across], axis=0) > 0.1):
            wrong += faults
    return wrong


def _moved_after_a_touch(texts: Texts) -> list[str]:
    """By hand, in the minus direction, along the sphere: nothing else tells it than where the axes are."""
    wrong = []
    usual = Cell(texts=texts)
    usual.safe_point()
    along = [int(np.argmax(np.abs(move.path[1] - move.path[0])[:3])) for move in usual.moves]
    touches = [next(n for n, move in enumerate(usual.moves) if move.met and along[n] == axis) for axis in range(3)]
    for touched, moved in permutations(range(3), 2):
        for where in ("after", "within"):
            cell = Cell(texts=texts)

            def after(number: int, cell: Cell = cell, at: int = touches[touched], axis: str = "XYZ"[moved]) -> None:
                cell.axes.position[axis] -= 1.5 if number == at else 0.0

            if where == "after":
                cell.axes.after = after
            else:
                cell.axes.jogged[touches[touched]] = {"XYZ"[moved]: -1.0}
            cell.safe_point()
            wrong += [f"{'XYZ'[touched]}, {where}, {'XYZ'[moved]}: {fault}" for fault in _answer(cell, 5, 12)]
    return wrong


def _stuck_high(texts: Texts) -> list[str]:
    """In a dry run that is so high that all of it is above TALC_SAFE_Z: up to the dry run's own height."""
    cell = Cell(texts=texts)
    cell.r[63] = 200.0

    def after(number: int) -> None:
        cell.axes.stuck |= number == 7

    cell.axes.after = after
    return _failed(cell, 10)


def stuck_at(texts: Texts, at: int) -> list[str]:
    """The probe sticks after a move."""
    cell = Cell(texts=texts)

    def after(number: int) -> None:
        cell.axes.stuck |= number == at

    cell.axes.after = after
    return _failed(cell, 10)


def _some(what: Callable[[Texts, int], list[str]], numbers: Sequence[int]) -> Callable[[Texts], list[str]]:
    return lambda texts: [f"move {number}: {fault}" for number in numbers for fault in what(texts, number)]


def _from(state: nc_starts.State) -> Callable[[Texts], list[str]]:
    return lambda texts: nc_starts.run(state, texts)[1]


CASES: dict[str, Callable[[Texts], list[str]]] = {
    **{f"from {name}": _from(state) for name, state in _STATES.items()},
    "nobody asks": _nobody,
    "withdrawn": _withdrawn,
    "expired": _expired,
    "no timer": _no_timer,
    "no limit": _no_limit,
    "TALC_SAFE_Z too low": _too_low,
    "dry run below the sphere": _below_zero,
    "a dry run without its height": _height_taken_away,
    "no probe": _no_probe,
    "loaded by hand": _loaded_by_hand,
    "no sphere": _no_sphere,
    "no sphere, and the spindle was on": _no_sphere_switched_on,
    "no probe, and the spindle was on": _no_probe_switched_on,
    "withdrawn, and the spindle or the fluid was on": _withdrawn_switched_on,
    "an alarm that stops something": _alarm_later,
    "beyond the travel": _beyond_travel,
    "a sphere that may be found too high": _found_too_high,
    "a sphere elsewhere": _moved_sphere,
    "a post on the table": _post,
    "a post on the way": _post_on_the_way,
    "other turns of the table": _other_turns,
    "something met in a dry run": _met_in_dry_run,
    "withdrawn within the cycle": _some(withdrawn_at, (0, 4, 7, 150, 151, 152)),
    "withdrawn while another asks": _withdrawn_while_another_asks,
    "a height that changes": _height_changed,
    "withdrawn after a failure": _withdrawn_after_a_failure,
    "asked while an axis moves": _asked_late,
    "after a failed dry run": _after_a_failure,
    "RESET": _some(reset_at, (0, 40, 300)),
    "RESET that nobody reports": _unreported,
    "RESET later": _reset_later,
    "moved by hand between moves": _some(jogged_at, (3, 4, 5, 6, 7, 98, 552)),
    "one axis moved by hand": _some(pushed_at, (3,)),
    "a loose sphere": _loose_sphere,
    "moved by hand within a touch": _some(jogged_within, (5,)),
    "moved by hand after a touch": _moved_after_a_touch,
    "a probe that sticks": _some(stuck_at, (2, 3, 6, 7)),
    "a probe that sticks in a high dry run": _stuck_high,
}


def main() -> None:
    texts, bad = program_texts(), 0
    usual = Cell(texts=texts)
    usual.safe_point()
    touches = [number for number, move in enumerate(usual.moves) if move.met]
    every = range(len(usual.moves))
    cases = CASES | {
        "RESET at every move": _some(reset_at, every),
        "withdrawn within every move": _some(withdrawn_at, every),
        "moved by hand after every move": _some(jogged_at, every),
        "moved by hand within every touch": _some(jogged_within, touches),
        "a probe that sticks after every move": _some(stuck_at, [n for n in every if n not in touches]),
    }
    for name, case in cases.items():
        wrong = case(texts)
        bad += bool(wrong)
        print(f"{name}: {'; '.join(wrong[:5]) or 'as it has to be'}", flush=True)
    sys.exit(bool(bad))


if __name__ == "__main__":
    main()
