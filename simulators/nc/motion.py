"""From the words of a block to where it takes the axes: units, diameter, frames, tool length, feed."""

from collections.abc import Mapping
from typing import Final, Protocol

from simulators.nc.axes import Path
from simulators.nc.expressions import Scope, converted
from simulators.nc.modal import Modal
from simulators.nc.operating import Frames, Told
from simulators.nc.statements import Words
from simulators.nc.synchronised import ProgramAlarm
from simulators.nc.tools import Tools
from simulators.nc.words import AXES, LINEAR

DRY_RUN_FEED: Final = 5000.0
"""SD42100, mm/min: what dry run makes of every feed."""
_TURN_DEG: Final = 360.0
"""Of a modulo axis, while MD30455 bit 0 is 0."""


class Moving(Scope, Protocol):
    """What is in force."""

    modal: Modal
    told: Told
    frames: Frames
    tools: Tools
    feed: float


def path_of(block: Words, state: Moving, before: Mapping[str, float], *, measures: bool) -> Path:
    """before: where the block before ends. Raises ProgramAlarm for what is not known here."""
    modal, told = state.modal, state.told
    if told.transformation or told.carrier or modal.has("G291") or modal.codes[7] != "G40":
        raise ProgramAlarm("a motion with a transformation, in ISO language or in a compensated contour")
    if modal.codes[1] != "G1":
        raise ProgramAlarm(f"a motion with {modal.codes[1]}: not known here")
    end, shortest = dict[str, float](), set[str]()
    for axis, source, direct in block.axes:
        value = float(converted(source(state), "REAL"))
        if axis in LINEAR:
            value *= modal.length_mm / (2.0 if axis == "X" and modal.has("DIAMON") else 1.0)
        if direct:
            if axis != "C":
                raise ProgramAlarm(f"{axis}: DC is for modulo axes")
            if not 0.0 <= value < _TURN_DEG:
                raise ProgramAlarm(f"16830: {axis}=DC({value:g}) is not within 0 to 359.999")
            shortest.add(axis)
        end[axis] = value + (before[axis] if modal.has("G91") and not direct else 0.0)
    if not modal.has("G91"):
        _from_workpiece(end, state, machine=block.machine)
    exact = modal.has("G60") and modal.has("G601")
    return Path(end, frozenset(shortest), _feed(end, state), measures, exact, dict(modal.codes))


def _from_workpiece(end: dict[str, float], state: Moving, *, machine: bool) -> None:
    """Frames, and the length of the tool whose edge is in force: from programmed end points to the axes'."""
    if not machine:
        if state.frames.turned and {"X", "Y"} <= end.keys():
            end["X"], end["Y"] = -end["Y"], end["X"]
        settable = state.frames.settable.get(state.modal.codes[8], (0.0,) * len(AXES))
        for axis, one, two in zip(AXES, settable, state.frames.shift, strict=True):
            if axis in end:
                end[axis] += one + two
    axis = {"G17": "Z", "G18": "Y", "G19": "X"}[state.modal.codes[6]]
    if axis in end and (state.told.length_stays or not machine):
        end[axis] += state.tools.length_mm


def _feed(end: Mapping[str, float], state: Moving) -> float:
    """mm/min, or degrees/min if only rotary axes move."""
    if not state.feed:
        raise ProgramAlarm("10860: no feed is programmed")
    if not state.modal.has("G94"):
        raise ProgramAlarm(f"a feed with {state.modal.codes[15]}: not known here")
    if state.told.dry_run:
        return DRY_RUN_FEED
    return state.feed * (state.modal.system_mm(metric=state.told.metric) if set(end) & set(LINEAR) else 1.0)
