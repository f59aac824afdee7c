"""Runs the probing programs from many states of the control: `python -m tests.benches.nc_starts --states 600`.

Each value of each state alone first, then seeded mixtures. What has to happen in a state is decided here by docs/nc.md:
nothing at all, a refusal with its reason before anything moves, or the intended way, with the state as before at its
end. Prints how many there were of each, and what was otherwise. A turned frame refuses nothing.
"""

import argparse
import itertools
import random
import sys
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any, NoReturn

from simulators.nc.modal import GROUPS
from simulators.nc.spindle import AS_AXIS, STANDS
from simulators.nc.synchronised import ProgramAlarm
from tests.benches.probing_programs import (
    PROBE_TOOL,
    SAFE_Z,
    Cell,
    centres_off_um,
    off_the_way,
    program_texts,
    reported,
    started_at,
    unsafe,
)

State = Mapping[str, Any]
CHOICES: dict[str, tuple[Any, ...]] = {
    **{f"group {number}": codes for number, codes in GROUPS.items()},
    "transformation": (0, 24),
    "tool carrier": (0, 1),
    "programmable frame": ("none", "shifted", "turned"),
    "basic system": ("metric", "inch"),
    "control is": (
        "ready",
        "searching",
        "testing",
        "simulating",
        "in dry run",
        "stopped by an alarm",
        "showing an alarm",
    ),
    "tool change mode": (1, 0),
    "edge after a change": (1, 0, -1, -2),
    "magazine management": (False, True),
    "tool": (3, PROBE_TOOL, 0),
    "edge": (2, 1, 0),
    "sum offset": (0, 2),
    "sum offset by default": (0, 1),
    "preselected": (3, 7, 0),
    "old tool's offset": (False, True),
    "the change moves Z": (True, False),
    "SUPA leaves the length": (True, False),
    "Z": (SAFE_Z + 100.0, SAFE_Z - 200.0),
    "A": (10.0, -30.0),
    "C": (0.0, 350.0, 7310.0),
    "not referenced": ("", "Z", "C"),
    "start lock": (True, False),
    "deflected": (False, True),
    "raised": (0.0, 50.0, 20.0),
    "spindle": (5, 3, 4),
    "spindle is": (
        "as programmed",
        "in position",
        "slowing down",
        "switched by hand",
        "turned by something",
        "an axis",
    ),
    "speed by": ("S", "nothing", "SVC", "a wheel"),
    "cutting fluid": (9, 7, 8),
    "group of the fluid": (0, 5),
    "Z goes to": (700.0, 400.0, SAFE_Z + 10.0),
    "blocks ahead": (1000, 0),
    "F": (1234.0, 0.0),
}
"""What a state is made of; the first values are the usual ones."""
USUAL = {name: values[0] for name, values in CHOICES.items()} | {"group 13": "G71", "group 15": "G94"}
_MIXED = 0.35
"""How often a value of a mixture is another than usual; a third of that where it ends the cycle early."""
_EARLY = {
    "group 7", "group 47", "transformation", "tool carrier", "control is", "not referenced", "deflected",
    "old tool's offset", "spindle is", "speed by",
}  # fmt: skip


def states(count: int) -> Iterator[dict[str, Any]]:
    """At least one for each value. Some make no difference to each other: the programs do not know that."""
    one = [USUAL | {name: value} for name, values in CHOICES.items() for value in values]
    yield from itertools.islice([USUAL, *one], count)
    draw = random.Random(1)
    for _ in range(count - 1 - len(one)):
        yield {
            name: draw.choice(values) if draw.random() < (_MIXED / 3.0 if name in _EARLY else _MIXED) else USUAL[name]
            for name, values in CHOICES.items()
        }


def made(state: State, texts: Mapping[str, str] | None = None) -> Cell:
    """A machine in a state. texts: of the programs; None: the supplied ones."""
    cell = Cell(ahead=state["blocks ahead"], texts=texts or program_texts())
    channel, tools, axes, told = cell.channel, cell.tools, cell.axes, cell.channel.told
    for number in GROUPS:
        channel.modal.switch(state[f"group {number}"])
    told.transformation, told.carrier = state["transformation"], state["tool carrier"]
    told.metric, told.start_lock = state["basic system"] == "metric", state["start lock"]
    told.search, told.test = state["control is"] == "searching", state["control is"] == "testing"
    told.simulation, told.dry_run = state["control is"] == "simulating", state["control is"] == "in dry run"
    told.alarm = {"stopped by an alarm": 0x240, "showing an alarm": 0x200}.get(state["control is"], 0)
    _spindle(cell, state)
    axes.limits = {**axes.limits, "Z": (axes.limits["Z"][0], state["Z goes to"])}
    told.length_stays = state["SUPA leaves the length"]
    channel.frames.settable = {"G54": (100.0, -50.0, 20.0, 4.0, -30.0), "G55": (-30.0, 10.0, -5.0, 0.0, 8.0)}
    channel.frames.shift = (5.0, 6.0, 7.0, 2.0, 10.0) if state["programmable frame"] != "none" else (0.0,) * 5
    channel.frames.turned = state["programmable frame"] == "turned"
    channel.feed = state["F"]
    tools.mode, tools.default = state["tool change mode"], state["edge after a change"]
    tools.managed, tools.sum_default = state["magazine management"], state["sum offset by default"]
    tool, edge = state["tool"], state["edge"] if state["tool"] else 0
    waits = state["preselected"] if tools.mode == 1 else tool
    tools.begin(tool, edge, state["sum offset"] if edge else 0, waits)
    if _old_offset(state):
        tools.keep_offset_of(7)
    tools.change_height = state["Z goes to"] - 50.0 if state["the change moves Z"] else None
    axes.position.update(Z=min(state["Z"], state["Z goes to"]), A=state["A"], C=state["C"])
    if state["not referenced"]:
        axes.homed[state["not referenced"]] = False
    axes.stuck = state["deflected"]
    cell.r[63] = state["raised"]
    cell.r[64:68] = [6.0, 3.0, 0.0, 6.0]
    return cell


def _spindle(cell: Cell, state: State) -> None:
    """As the part program has it, and as it is."""
    spindle, how = cell.channel.spindle, state["spindle is"]
    by = {"nothing": 0, "S": 3 if state["group 15"] == "G96" else 1, "SVC": 2, "a wheel": 4}[state["speed by"]]
    spindle.kind, spindle.s = by, {by: 800.0} if by else {}
    spindle.direction = state["spindle"]
    spindle.switch(state["spindle"])
    spindle.wait()
    if how == "slowing down":
        spindle.speed = 300.0
    elif how == "in position":
        spindle.turn_to(123.0)
    elif how == "an axis":
        spindle.mode, spindle.speed = AS_AXIS, 0.0
    elif how != "as programmed":
        spindle.switched = {5: 4, 3: 5, 4: 3}[state["spindle"]] if how == "switched by hand" else state["spindle"]
        stopped = how == "switched by hand" and spindle.switched == STANDS  # which the next M3 would start again
        spindle.by_hand, spindle.speed = not stopped, 0.0 if stopped else -500.0
    spindle.fluid = state["cutting fluid"]
    cell.channel.data("TALC_FLUID_GROUP")[0] = state["group of the fluid"]
    spindle.show()


def _old_offset(state: State) -> bool:
    """MD20270 = -2, and no D since the last change."""
    return bool(state["old tool's offset"] and state["edge after a change"] == -2 and state["tool"] and state["edge"])


def silent(state: State) -> bool:
    """Nothing may happen: the program returns before it reads anything."""
    in_contour = state["group 7"] != "G40" or state["group 1"] == "G33" or "SPLINE" in state["group 1"]
    in_contour = in_contour or state["group 1"] == "POLY" or state["group 47"] != "G290"
    return in_contour or state["control is"] in ("searching", "testing", "simulating")


_NOT_THE_PROGRAM_S = ("switched by hand", "turned by something", "an axis")
OF_THE_FOUR = {9: "a transformation or tool carrier", 13: "an axis is not referenced", 14: "the tool is not known"}
BEYOND = {
    16: "the spindle is not as the program has it",
    17: "the control's own dry run",
    18: "the way ends beyond Z",
}


def refused(state: State) -> set[int]:
    """The reasons that apply (R66)."""
    edge, managed = state["edge"] if state["tool"] else 0, state["magazine management"]
    unsure = state["edge after a change"] == -2 or (state["edge after a change"] == 0 and not edge)
    return {
        reason
        for reason, applies in (
            (9, state["transformation"] or state["tool carrier"]),
            (13, state["not referenced"]),
            (14, _old_offset(state) if managed else unsure),
            (16, state["spindle is"] in _NOT_THE_PROGRAM_S or state["speed by"] == "a wheel"),
            (17, state["control is"] == "in dry run"),
            (18, SAFE_Z + state["raised"] > state["Z goes to"]),
        )
        if applies
    }


def run(state: State, texts: Mapping[str, str] | None = None) -> tuple[str, list[str]]:
    """How it ended, and what was not as it has to be."""
    cell = made(state, texts)
    before, start, r = cell.state(), started_at(cell), list(cell.r)
    raised = state["raised"]
    try:
        cell.safe_point()
    except ProgramAlarm as alarm:
        locked, stopped = state["not referenced"] and state["start lock"], state["control is"] == "stopped by an alarm"
        wrong = [] if (locked or stopped) and not cell.moves and cell.r == r else [str(alarm)]
        return REFUSED_BY_CONTROL[not locked], wrong
    wrong = [] if cell.state() == before else [f"{before} became {cell.state()}"]
    if silent(state):
        wrong += ["R-parameters were written"] * (cell.r != r) + ["something moved"] * bool(cell.moves)
        return "nothing happens", wrong
    if reasons := refused(state):
        wrong += ["something moved"] * bool(cell.moves) + ["a tool was changed"] * bool(cell.tools.changes)
        if cell.r[64] != 7 or cell.r[65] != 4 or cell.r[66] not in reasons or cell.r[67] != 0:
            wrong.append(f"R65 = {cell.r[65]:g}, R66 = {cell.r[66]:g}: expected refused for {reasons}")
        least = min(reasons)  # one of the four, if there is any
        return f"refused, {OF_THE_FOUR.get(least) or 'beyond: ' + BEYOND[least]} ({least})", wrong
    wrong += unsafe(cell, raised)
    if state["deflected"]:
        moved = [*wrong, *(["a deflected probe moved elsewhere than up"] * _not_only_up(cell))]
        ended = cell.r[64:68] == [7, 5, 10, 0]
        return "the probe is deflected: failed", [*moved, *([f"R64 to R67 = {cell.r[64:68]}"] * (not ended))]
    wrong += off_the_way(cell, start, raised)
    return "the intended way", [*wrong, *_answered_wrongly(cell, raised, before["tools"][0])]


def _answered_wrongly(cell: Cell, raised: float, tool: int) -> list[str]:
    wrong = ["the part program is stopped"] * bool(cell.halts)
    if cell.r[64:68] != [7, 3, 0, 7]:
        wrong.append(f"R64 to R67 = {cell.r[64:68]}")
    elif centres_off_um(cell, raised) > 2.0 or cell.r[88] > 0.002:
        wrong.append(f"centres are off by {centres_off_um(cell, raised):.1f} um, R88 = {cell.r[88]:g}")
    if reported(cell)[:3] != [(65, 0), (67, 0), (64, 7)]:
        wrong.append("an old state or result stands under the new number")
    if [number for number, _ in reported(cell)][-2:] != [67, 65]:
        wrong.append("R65 = 3 is not the last, after R67")
    states = [(value, at) for number, value, at, _ in cell.channel.written if number == 65]
    if [value for value, _ in states] != [0, 1, 2, 1, 3]:
        return [*wrong, f"R65 is {[value for value, _ in states]} in turn"]
    frozen = [at for _, at in states[2:4]]
    if [at["Z"] for at in frozen] != [SAFE_Z + raised] * 2 or frozen[0]["X"] != frozen[1]["X"]:
        wrong.append("the offsets are frozen or let go elsewhere than over the sphere")
    if [at["T"] for _, at in states[1:]] != [tool, PROBE_TOOL, PROBE_TOOL, tool]:
        wrong.append("R65 becomes 3 before the tool is back")
    return wrong


def _not_only_up(cell: Cell) -> bool:
    return any(
        (move.path[-1] - move.path[0] < -1e-9).any() or move.path[-1, 2] <= move.path[0, 2] for move in cell.moves
    )


REFUSED_BY_CONTROL = ("the control starts nothing: an axis is not referenced", "the control starts nothing: an alarm")


def tell(ended: Counter[str], what: str, bad: int) -> NoReturn:
    """Print how each ended, and exit with 1 if any was bad."""
    for how, count in ended.most_common():
        print(f"{count:5d}  {how}")
    print(f"{sum(ended.values()):5d}  {what}, {bad} not as they have to be")
    sys.exit(bool(bad))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--states", type=int, default=600)
    ended, bad = Counter[str](), 0
    for number, state in enumerate(states(parser.parse_args().states)):
        how, wrong = run(state)
        ended[how] += 1
        if wrong:
            bad += 1
            other = {name: value for name, value in state.items() if value != USUAL[name]}
            print(f"state {number}: {how}, but {'; '.join(wrong[:3])}\n    {other}", flush=True)
    four = sum(count for how, count in ended.items() if how.startswith(("refused, ", REFUSED_BY_CONTROL[0])))
    beyond = sum(count for how, count in ended.items() if "beyond" in how)
    print(f"{four - beyond:5d}  refused for one of the four, {beyond} beyond them")
    tell(ended, "states", bad)


if __name__ == "__main__":
    main()
