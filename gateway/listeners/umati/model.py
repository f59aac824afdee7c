"""The part of OPC 40501-1 that a gateway can fill, as tables.

They hold the types with their published NodeIds, and one machine's nodes.

Sources: OPC 40501-1 (MachineTool 1.02), OPC 40001-1 (Machinery), OPC 10000-100 (DI). Only types that occur are there,
without the nodes that only describe them.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, Literal

from gateway.listeners.umati.settings import ShownMachine
from gateway.listeners.umati.values import ERRORS_FOLDER, NEXT, OFFSETS_FOLDER, RUN, SIGMAS, Path
from talc.names import ERROR_UNITS, MICROMETRE, THERMAL_ERRORS

Space = Literal["base", "di", "machinery", "machine_tool", "own"]
URIS: Final[Mapping[Space, str]] = {
    "di": "http://opcfoundation.org/UA/DI/",
    "machinery": "http://opcfoundation.org/UA/Machinery/",
    "machine_tool": "http://opcfoundation.org/UA/MachineTool/",
    "own": "urn:talc-gateway",
}
MACHINES_NODE: Final = 1001
"""Object of the namespace machinery, in which all machines of a server are."""
OPERATION_MODE: Final = 65
"""Data type of the namespace machine_tool."""
OPERATION_MODES: Final = ("Manual", "Automatic", "Setup", "AutoWithManualIntervention", "Service", "Other")
NOT_KNOWN: Final = "BadNotSupported"
"""Status of what the specification demands and no gateway knows."""

Id = tuple[Space, int]
FOLDER: Id = ("base", 61)
OBJECT: Id = ("base", 58)
PROPERTY: Id = ("base", 68)
VARIABLE: Id = ("base", 63)
ANALOG: Id = ("base", 17497)
"""AnalogUnitType: a number that has a unit."""
_STATE_MACHINE: Id = ("base", 2771)
_CURRENT_STATE: Id = ("base", 2760)


@dataclass(frozen=True, slots=True)
class TypeSpec:
    """One object type of a companion specification."""

    space: Space
    number: int
    name: str
    above: Id
    abstract: bool = False


OBJECT_TYPES: Final = (
    TypeSpec("di", 1005, "FunctionalGroupType", FOLDER),
    TypeSpec("machinery", 1004, "MachineryItemIdentificationType", ("di", 1005), abstract=True),
    TypeSpec("machinery", 1012, "MachineIdentificationType", ("machinery", 1004)),
    TypeSpec("machine_tool", 13, "MachineToolType", OBJECT),
    TypeSpec("machine_tool", 11, "MachineToolIdentificationType", ("machinery", 1012)),
    TypeSpec("machine_tool", 43, "SoftwareIdentificationType", OBJECT),
    TypeSpec("machine_tool", 14, "MonitoringType", OBJECT),
    TypeSpec("machine_tool", 26, "MachineOperationMonitoringType", OBJECT),
    TypeSpec("machine_tool", 7, "NotificationType", OBJECT),
    TypeSpec("machine_tool", 2, "PrognosisListType", OBJECT),
    TypeSpec("machine_tool", 3, "PrognosisType", OBJECT, abstract=True),
    TypeSpec("machine_tool", 9, "MaintenancePrognosisType", ("machine_tool", 3)),
    TypeSpec("machine_tool", 12, "EquipmentType", OBJECT),
    TypeSpec("machine_tool", 21, "ProductionType", OBJECT),
    TypeSpec("machine_tool", 59, "ProductionProgramType", OBJECT),
    TypeSpec("machine_tool", 32, "ProductionActiveProgramType", ("machine_tool", 59)),
    TypeSpec("machine_tool", 24, "ProductionStateMachineType", _STATE_MACHINE),
    TypeSpec("machine_tool", 15, "ProductionProgramStateMachineType", ("machine_tool", 24)),
)
"""Each after the one above it."""


@dataclass(frozen=True, slots=True)
class NodeSpec:
    """One node below a machine."""

    space: Space
    """Namespace of its BrowseName."""
    name: str
    kind: Id
    """Its type; a property's is PropertyType."""
    data: str | Id = ""
    """Built-in type or data type of a variable; empty: an object."""
    shows: Path | None = None
    """What fills it."""
    fixed: str | None = None
    """Value that does not change."""
    unit: str = ""
    below: tuple["NodeSpec", ...] = field(default=())


def machine_nodes(machine: str, shown: ShownMachine) -> NodeSpec:
    """All nodes of one machine, but for its channels, which are known when they are heard."""
    return NodeSpec(
        "own",
        machine,
        ("machine_tool", 13),
        below=(
            _identification(machine, shown),
            NodeSpec("machine_tool", "Equipment", ("machine_tool", 12)),
            _monitoring(),
            _notification(),
            _production(),
        ),
    )


def quantity(name: str, unit: str, shows: Path) -> NodeSpec:
    """A number with a unit."""
    return NodeSpec("own", name, ANALOG, "Double", shows, unit=unit)


def _identification(machine: str, plate: ShownMachine) -> NodeSpec:
    software = NodeSpec(
        "own",
        "TalcGateway",
        ("machine_tool", 43),
        below=(
            NodeSpec("machine_tool", "Identifier", PROPERTY, "String", fixed="talc-gateway"),
            NodeSpec("di", "SoftwareRevision", PROPERTY, "String", (RUN, "Version")),
        ),
    )
    uri = plate.product_instance_uri or f"urn:talc-gateway:{machine}"
    given = [
        NodeSpec("di", "Manufacturer", PROPERTY, "LocalizedText", fixed=plate.manufacturer),
        NodeSpec("di", "SerialNumber", PROPERTY, "String", fixed=plate.serial_number),
        NodeSpec("di", "ProductInstanceUri", PROPERTY, "String", fixed=uri),
    ]
    if plate.model is not None:
        given.append(NodeSpec("di", "Model", PROPERTY, "LocalizedText", fixed=plate.model))
    if plate.location is not None:
        given.append(NodeSpec("machinery", "Location", PROPERTY, "String", fixed=plate.location))
    group = NodeSpec("machine_tool", "SoftwareIdentification", OBJECT, below=(software,))
    return NodeSpec("di", "Identification", ("machine_tool", 11), below=(*given, group))


def _monitoring() -> NodeSpec:
    errors, sigmas = (
        NodeSpec("own", group, FOLDER, below=tuple(quantity(e, ERROR_UNITS[e], (group, e)) for e in THERMAL_ERRORS))
        for group in (ERRORS_FOLDER, SIGMAS)
    )
    offsets = NodeSpec(
        "own", OFFSETS_FOLDER, FOLDER, below=tuple(quantity(axis, MICROMETRE, (OFFSETS_FOLDER, axis)) for axis in "XYZ")
    )
    states = {"Phase": "String", "Control": "String", "ChannelsConfigured": "UInt32", "ChannelsGood": "UInt32",
              "WaitsFor": "String[]"}  # fmt: skip
    run = NodeSpec(
        "own", RUN, FOLDER, below=tuple(NodeSpec("own", n, VARIABLE, d, (RUN, n)) for n, d in states.items())
    )
    tool = NodeSpec(
        "machine_tool",
        "MachineTool",
        ("machine_tool", 26),
        below=(NodeSpec("machine_tool", "OperationMode", VARIABLE, ("machine_tool", OPERATION_MODE)),),
    )
    channels = NodeSpec("own", "Channels", FOLDER)
    return NodeSpec(
        "machine_tool", "Monitoring", ("machine_tool", 14), below=(tool, errors, sigmas, offsets, run, channels)
    )


def _notification() -> NodeSpec:
    """A probing cycle interrupts production for the sake of the machine. Of the specification's prognoses only
    maintenance says so without requiring a person."""
    cycle = NodeSpec(
        "own",
        "NextProbingCycle",
        ("machine_tool", 9),
        below=(
            NodeSpec("machine_tool", "PredictedTime", PROPERTY, "DateTime", (NEXT, "PredictedTime")),
            NodeSpec("machine_tool", "Activity", VARIABLE, "LocalizedText", (NEXT, "Activity")),
            NodeSpec("own", "Reason", VARIABLE, "String", (NEXT, "Reason")),
            NodeSpec("own", "Standing", VARIABLE, "String", (NEXT, "Standing")),
        ),
    )
    prognoses = NodeSpec("machine_tool", "Prognoses", ("machine_tool", 2), below=(cycle,))
    return NodeSpec("machine_tool", "Notification", ("machine_tool", 7), below=(prognoses,))


def _production() -> NodeSpec:
    """The specification demands these nodes; the control's own server is the one to fill them."""
    current = NodeSpec(
        "base",
        "CurrentState",
        _CURRENT_STATE,
        "LocalizedText",
        below=(NodeSpec("base", "Id", PROPERTY, "NodeId"), NodeSpec("base", "Number", PROPERTY, "UInt32")),
    )
    program = NodeSpec(
        "machine_tool",
        "ActiveProgram",
        ("machine_tool", 32),
        below=(
            NodeSpec("machine_tool", "Name", PROPERTY, "String"),
            NodeSpec("base", "NumberInList", PROPERTY, "UInt16"),
            NodeSpec("machine_tool", "State", ("machine_tool", 15), below=(current,)),
        ),
    )
    return NodeSpec("machine_tool", "Production", ("machine_tool", 21), below=(program,))
