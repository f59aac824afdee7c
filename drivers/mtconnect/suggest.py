"""Suggests which of an agent's data items the gateway probably wants: a first guess for a person."""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field

from drivers.mtconnect.document import Element, data_items, elements
from drivers.mtconnect.items import FIXED_SYSTEMS, ITEM_TYPES, POSITION_UNITS, SPEED_UNITS
from drivers.nc import LINEAR_AXES

_SPEED_TYPES = ("AXIS_FEEDRATE", "ANGULAR_VELOCITY", "ROTARY_VELOCITY", "SPINDLE_SPEED")
_PREFERRED = ("ACTUAL", "", "COMMANDED")
"""Subtypes, best first; any other, such as an override, is no candidate."""


@dataclass(frozen=True, slots=True)
class SuggestedItems:
    """Settings of an MTConnect control, by name; what the agent does not have is missing."""

    machine: str = ""
    """The machine that they belong to, if the agent has several."""
    positions: Mapping[str, str] = field(default_factory=dict)
    states: Mapping[str, str] = field(default_factory=dict)
    named: Mapping[str, str] = field(default_factory=dict)
    """`mode`, `program`, `tool` and `emergency_stop`."""


def suggested_items(document: bytes) -> SuggestedItems:
    """A guess from an answer to `probe`; of several machines, the first one's.

    X to C are the Linear and Rotary components of these names (`X`, or `X1`, or so called by the control: `nativeName`)
    that have a position in coordinates that do not move. The spindle is the first Rotary with a speed but no angle.
    Raises ValueError: not XML, an agent's error, or without a machine.
    """
    found = elements(document)
    devices = [e for e in found if e.name == "Device"]
    if not devices:
        raise ValueError("it describes no machine: there is no element Device")
    described = data_items(found)
    items = [_PlacedItem(e, described) for e in found if e.name == "DataItem" and "id" in e.attributes]
    items = [item for item in items if devices[0] in item.around]
    chosen: dict[str, str] = {}
    turning = [item.axis for item in items if item.type == "ANGLE"]
    for name, units in POSITION_UNITS.items():
        component, kind = ("Linear", "POSITION") if name in LINEAR_AXES else ("Rotary", "ANGLE")
        axes = [i.axis for i in items if i.type == kind and i.axis is not None and i.axis.name == component]
        axis = _named(name, axes)
        its = [] if axis is None else [item for item in items if item.axis is axis]
        chosen |= _best(name, (i for i in its if i.type == kind and i.system in FIXED_SYSTEMS), units)
        speeds = (i for i in its if i.type in _SPEED_TYPES)
        chosen |= _best(f"speed_{name}", speeds, SPEED_UNITS[f"speed_{name}"])
    rotary = (i for i in items if i.axis is not None and i.axis.name == "Rotary" and i.axis not in turning)
    spindle = (i for i in rotary if i.type in _SPEED_TYPES)
    chosen |= _best("spindle_speed", spindle, SPEED_UNITS["spindle_speed"])
    for name, kind in ITEM_TYPES.items():
        chosen |= _best(name, (i for i in items if i.type == kind), ("",))
    first = devices[0].attributes
    return SuggestedItems(
        machine=(first.get("name") or first.get("uuid", "")) if len(devices) > 1 else "",
        positions={name: item for name, item in chosen.items() if name in POSITION_UNITS},
        states={name: chosen[name] for name in SPEED_UNITS if name in chosen},
        named={name: item for name, item in chosen.items() if name in ITEM_TYPES},
    )


class _PlacedItem:
    """A data item, and where it stands."""

    def __init__(self, element: Element, described: Mapping[str, Mapping[str, str]]) -> None:
        self.id = element.attributes["id"]
        about = described[self.id]
        self.type = "" if about.get("category") == "CONDITION" else about.get("type", "")
        self.unit, self.subtype = about.get("units", ""), about.get("subType", "")
        self.system = about.get("coordinateSystem", "MACHINE")
        self.around = list(_around(element))
        self.axis = next((e for e in self.around if e.name in ("Linear", "Rotary")), None)


def _around(element: Element) -> Iterator[Element]:
    """The elements that contain it, the nearest first."""
    at = element.parent
    while at is not None:
        yield at
        at = at.parent


def _best(name: str, items: Iterator[_PlacedItem], units: Collection[str]) -> dict[str, str]:
    """`name` with the id of the first item of the best subtype in one of these units; empty: there is none."""
    fit = [item for item in items if item.unit in units and item.subtype in _PREFERRED]
    return {name: min(fit, key=lambda item: _PREFERRED.index(item.subtype)).id} if fit else {}


def _named(name: str, axes: Collection[Element]) -> Element | None:
    """The axis of this name, else the first that the control calls so, else the first with a number behind it."""
    for key, cut in (("name", ""), ("nativeName", ""), ("name", "0123456789")):
        for axis in axes:
            if axis.attributes.get(key, "").rstrip(cut) == name:
                return axis
    return None
