"""Types and units of MTConnect's data items, and the check that each item fits what it is configured for."""

import math
from collections.abc import Mapping

from drivers.base import BadAnswer, WrongDevice
from drivers.mtconnect.settings import MtConnectSettings
from drivers.nc import LINEAR_AXES, ROTARY_AXES
from drivers.number_types import WRITTEN_NUMBER
from drivers.text import Text

_MM = {"MILLIMETER": 1.0}
_DEGREES = {"DEGREE": 1.0}
_MM_PER_MIN = {"MILLIMETER/SECOND": 60.0}
_TURNS_PER_MIN = {"REVOLUTION/MINUTE": 1.0, "REVOLUTION/SECOND": 60.0, "DEGREE/SECOND": 1.0 / 6.0}
POSITION_UNITS = dict.fromkeys(LINEAR_AXES, _MM) | dict.fromkeys(ROTARY_AXES, _DEGREES)
SPEED_UNITS = {
    "spindle_speed": _TURNS_PER_MIN,
    **{f"speed_{axis}": _MM_PER_MIN for axis in LINEAR_AXES},
    **{f"speed_{axis}": _TURNS_PER_MIN for axis in ROTARY_AXES},
}
"""States whose unit the gateway defines, and MTConnect's units with their factor."""
SWITCHED = {"ON": 1.0, "ACTIVE": 1.0, "OPEN": 1.0, "OFF": 0.0, "INACTIVE": 0.0, "CLOSED": 0.0}
"""Values of other states that are words."""
FIXED_SYSTEMS = ("MACHINE", "WORLD", "BASE")
"""Types of coordinate systems that stay where they are."""
ITEM_TYPES = {
    "mode": "CONTROLLER_MODE",
    "program": "EXECUTION",
    "tool": "TOOL_NUMBER",
    "emergency_stop": "EMERGENCY_STOP",
}
"""Settings that name one data item, and the type that it must have."""


def factors(settings: MtConnectSettings, found: Mapping[str, Mapping[str, str]]) -> dict[str, float]:
    """Axis or state to the factor from its data item's unit to the gateway's.

    found: id to attributes, as the agent tells them . Raises WrongDevice for a data item that the agent does not have
    or that is something else, naming field, id and what is expected.
    """
    for name, kind in ITEM_TYPES.items():
        item = getattr(settings, name)
        if item and (told := _of(found, name, item).get("type")) != kind:
            raise WrongDevice(Text("mtc_type", name=name, item=repr(item), told=told, kind=kind), device="nc")
    made = {}
    for axis, item in settings.positions.items():
        about = _of(found, f"positions.{axis}", item)
        if (system := about.get("coordinateSystem", "MACHINE")) not in FIXED_SYSTEMS:
            what = Text("mtc_coordinates", axis=axis, item=repr(item), system=system)
            raise WrongDevice(what, device="nc", hint=Text("mtc_machine_coordinates"))
        made[axis] = _factor(f"positions.{axis}", item, about, POSITION_UNITS[axis])
    for name, item in settings.states.items():
        about = _of(found, f"states.{name}", item)
        made[name] = _factor(f"states.{name}", item, about, SPEED_UNITS[name]) if name in SPEED_UNITS else 1.0
    return made


def _of(found: Mapping[str, Mapping[str, str]], where: str, item: str) -> Mapping[str, str]:
    if item not in found:
        raise WrongDevice(Text("mtc_no_item", where=where, item=repr(item)), device="nc", hint=Text("mtc_see_probe"))
    if not found[item]:
        raise WrongDevice(Text("mtc_twice", where=where, item=repr(item)), device="nc", hint=Text("mtc_state_machine"))
    return found[item]


def _factor(where: str, item: str, about: Mapping[str, str], units: Mapping[str, float]) -> float:
    unit = about.get("units", "")
    if unit not in units:
        raise WrongDevice(
            Text("mtc_unit", where=where, item=repr(item), unit=unit or Text("mtc_no_unit"), wanted=" or ".join(units)),
            device="nc",
        )
    return units[unit]


def number(item: str, text: str, factor: float) -> float:
    """What an agent reports of a data item, in the gateway's unit. Raises BadAnswer: not a finite number."""
    value = float(text) * factor if WRITTEN_NUMBER.fullmatch(text.strip()) else math.nan
    if not math.isfinite(value):
        raise BadAnswer(Text("mtc_no_number", item=item, text=repr(text[:40])), device="nc")
    return value
