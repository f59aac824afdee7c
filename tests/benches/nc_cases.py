"""What can happen at a machine while it is probed: each case says what was not as it has to be.

`python -m tests.benches.nc_cases` runs all of them, and RESET, a stop with the axes moved by hand and a probe that
sticks at every move of a cycle.
"""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from simulators.nc.axes import Reset
from simulators.nc.synchronised import ProgramAlarm
from tests.benches import nc_starts
from tests.benches.probed_workshop import Workshop
from tests.benches.probing_programs import (
    CLEARANCE_MM,
    POSES,
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
    "the spindle turns": nc_starts.USUAL | {"spindle": 3},
    "the spindle turns backwards": nc_starts.USUAL | {"spindle": 4},
    "the spindle was switched on by hand": nc_starts.USUAL | {"spindle speed": 500.0},
    "the spindle was switched on backwards by hand": nc_starts.USUAL | {"spindle speed": -500.0},
    "alarm": nc_starts.USUAL | {"control is": "alarmed"},
    **{f"control is {what}": nc_starts.USUAL | {"control is": what} for what in nc_starts.CHOICES["control is"][1:5]},
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
    try:
        cell.safe_point()
    except ProgramAlarm as alarm:
        return [str(alarm)]
    wrong = [*_answer(cell, 5, reason), *unsafe(cell, cell.r[63])]
    if cell.moves and cell.moves[-1].path[-1, 2] < SAFE_Z + cell.r[63] - 1e-3:
        wrong.append("the probe is left below TALC_SAFE_Z")
    if cell.state() != before:
        wrong.append(f"{before} became {cell.state()}")
    if cell.moves and cell.workshop.gap(cell.moves[-1].path[-1:])[0] < CLEARANCE_MM:
        wrong.append("the probe is left at what it met")
    if cell.axes.probe_on:
        wrong.append("the probe stays switched on")
    if len(cell.halts) != (reason != 4) or not all(cell.halts):
        wrong.append(f"stopped with {cell.halts}, and NC start is needed unless it was withdrawn")
    *_, (_, let_go), (state, ended) = [(value, at) for number, value, at, _ in cell.channel.written if number == 65]
    if let_go["Z"] < SAFE_Z + cell.r[63] - 1e-3:
        wrong.append("the offsets are let go before the probe is up")
    if state != 5.0 or ended["T"] != before["tools"][0]:
        wrong.append("R65 becomes 5 before the tool is back")
    return wrong


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


def _met_in_dry_run(texts: Texts) -> list[str]:
    """The sphere is as much higher as the whole way: a touch meets it."""
    cell = Cell(Workshop((_SPHERE[0], _SPHERE[1], _SPHERE[2] + 50.0)), texts)
    cell.r[63] = 50.0
    return _failed(cell, 11)


def withdrawn_at(texts: Texts, at: int) -> list[str]:
    """Withdrawn within a move: after it, and after the way back from what it met, it goes up only."""
    cell = Cell(texts=texts)

    def before(number: int) -> None:
        cell.r[61] = 7.0 if number == at else cell.r[61]

    cell.axes.before = before
    wrong = _failed(cell, 4)
    back = any(move.met for move in cell.moves[at : at + 1])
    return [*wrong, *(["went on"] if len(cell.moves) > at + 2 + back else [])]


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


def _asked_late(texts: Texts) -> list[str]:
    """The request comes while the block before the call still moves."""
    cell = Cell(texts={**texts, "part": "PROC PART_PROGRAM DISPLOF\nSUPA G1 Y=-60 F=1000\nTALC_SAFE_POINT\nRET"})
    cell.channel.modal.switch("G94")
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
    cell = Cell(texts=texts)

    def before(number: int) -> None:
        if number == 63:
            cell.workshop.sphere_mm = (_SPHERE[0] + 0.05, *_SPHERE[1:])

    cell.axes.before = before
    cell.safe_point()
    return [] if cell.r[65] == 3.0 and abs(cell.r[88] - 0.05) < 0.002 else [f"R88 = {cell.r[88]:g}"]


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
    "no sphere": _no_sphere,
    "a sphere elsewhere": _moved_sphere,
    "a post on the table": _post,
    "a post on the way": _post_on_the_way,
    "something met in a dry run": _met_in_dry_run,
    "withdrawn within the cycle": _some(withdrawn_at, (0, 4, 7, 150, 151, 152)),
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
    "a probe that sticks": _some(stuck_at, (2, 3, 6, 7)),
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
