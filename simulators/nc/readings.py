"""System variables that a part program reads, as far as ours do."""

from collections.abc import Callable, Mapping
from typing import Final, Protocol

from simulators.nc.axes import Axes
from simulators.nc.expressions import Value, converted
from simulators.nc.modal import Modal
from simulators.nc.operating import Told
from simulators.nc.spindle import Spindle
from simulators.nc.synchronised import ProgramAlarm
from simulators.nc.tools import Tools
from simulators.nc.words import AXES, LINEAR

_MASTER: Final = 1


class Read(Protocol):
    """Of which channel."""

    axes: Axes
    spindle: Spindle
    tools: Tools
    told: Told
    modal: Modal
    feed: float


def reading(channel: Read, name: str, index: Value | None) -> Value | None:
    """None: not one of these. Raises ProgramAlarm for an index that it does not have."""
    if (name, index) == ("$AA_IM", f"S{_MASTER}"):
        return channel.spindle.angle_deg
    if name in _OF_AN_AXIS:
        if index not in AXES:
            raise ProgramAlarm(f"{name}[{index}]: expected an axis")
        return _OF_AN_AXIS[name](channel, str(index))
    if name in _NUMBERED:
        return _NUMBERED[name](channel, int(converted(index if index is not None else 0, "INT")))
    if name not in _SINGLE:
        return None
    if index is not None:
        raise ProgramAlarm(f"{name} has no index")
    return _SINGLE[name](channel)


def _place(channel: Read, axis: str, position: Mapping[str, float]) -> float:
    """C within a turn, lengths in the program's unit."""
    return position[axis] % 360.0 if axis == "C" else _length(channel, axis, position[axis])


def _length(channel: Read, axis: str, value: float) -> float:
    return value / channel.modal.system_mm(metric=channel.told.metric) if axis in LINEAR else value


_OF_AN_AXIS: Final[dict[str, Callable[[Read, str], Value]]] = {
    "$AA_IM": lambda c, axis: _place(c, axis, c.axes.position),
    "$AA_MM": lambda c, axis: _place(c, axis, c.axes.latched),
    "$AA_REF": lambda c, axis: int(c.axes.homed[axis]),
    "$AA_SOFTENDN": lambda c, axis: _length(c, axis, c.axes.limits[axis][0]),
    "$AA_SOFTENDP": lambda c, axis: _length(c, axis, c.axes.limits[axis][1]),
}
_NUMBERED: Final[dict[str, Callable[[Read, int], Value]]] = {
    "$P_GG": lambda c, group: c.modal.number(group),
    "$A_PROBE": lambda c, _: int(c.axes.deflected),
    "$AC_MEA": lambda c, _: int(c.axes.triggered),
    "$P_SDIR": lambda c, _: c.spindle.direction,
    "$P_S_TYPE": lambda c, _: c.spindle.kind,
    "$P_S": lambda c, _: c.spindle.value(1),
    "$P_SVC": lambda c, _: c.spindle.value(2),
    "$P_CONSTCUT_S": lambda c, _: c.spindle.value(3),
    "$AC_SDIR": lambda c, _: c.spindle.switched,
    "$AC_SPIND_STATE": lambda c, _: c.spindle.mode,
    "$AA_S": lambda c, _: c.spindle.speed,
    "$AC_AUXFU_M_VALUE": lambda c, group: c.spindle.fluid if group == c.told.fluid_group - 1 else -1,
}
_SINGLE: Final[dict[str, Callable[[Read], Value]]] = {
    "$P_SIM": lambda c: c.told.simulation,
    "$P_SEARCH": lambda c: c.told.search,
    "$P_ISTEST": lambda c: c.told.test,
    "$P_DRYRUN": lambda c: c.told.dry_run,
    "$P_TRAFO": lambda c: c.told.transformation,
    "$P_TC": lambda c: c.told.carrier,
    "$P_PROG_EVENT": lambda c: c.told.event,
    "$AC_ALARM_STAT": lambda c: c.told.alarm,
    "$P_F": lambda c: c.feed,
    "$P_MSNUM": lambda _: _MASTER,
    "$P_TOOL": lambda c: c.tools.edge,
    "$P_DLNO": lambda c: c.tools.sum,
    "$P_TOOLNO": lambda c: c.tools.number,
    "$P_TOOLP": lambda c: c.tools.programmed,
    "$MC_TOOL_CHANGE_MODE": lambda c: c.tools.mode,
    "$MC_CUTTING_EDGE_DEFAULT": lambda c: c.tools.default,
    "$MC_TOOL_MANAGEMENT_MASK": lambda c: int(c.tools.managed),
}
