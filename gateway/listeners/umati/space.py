"""The nodes of the model in an asyncua server, and their values."""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Final, cast

from asyncua import ua
from asyncua.server.internal_server import InternalServer
from asyncua.ua.attribute_ids import AttributeIds
from asyncua.ua.status_codes import StatusCodes

from gateway.listeners.umati.model import (
    MACHINES_NODE,
    NOT_KNOWN,
    OBJECT_TYPES,
    OPERATION_MODE,
    OPERATION_MODES,
    PROPERTY,
    URIS,
    Id,
    NodeSpec,
    Space,
    quantity,
)
from gateway.listeners.umati.values import CHANNELS, GOOD, UNKNOWN, NodeShown, Path

_UNITS: Final[Mapping[str, tuple[int, str]]] = {
    "µm": (13384, "micrometre (micron)"),
    "um": (13384, "micrometre (micron)"),
    "mm": (5066068, "millimetre"),
    "degC": (4408652, "degree Celsius"),
    "K": (4932940, "kelvin"),
    "1/min": (5394509, "revolutions per minute"),
    "l/min": (19506, "litre per minute"),
    "bar": (4342098, "bar [unit of pressure]"),
    "mbar": (5063250, "millibar"),
    "Pa": (5259596, "pascal"),
    "N": (5129559, "newton"),
    "W": (5723220, "watt"),
    "kW": (4937556, "kilowatt"),
    "A": (4279632, "ampere"),
    "V": (5655636, "volt"),
    "Hz": (4740186, "hertz"),
    "%": (20529, "percent"),
}
"""UNECE Rec. 20 as OPC UA numbers it (Part 8, 5.6.3). Others, µm/m among them, are named without a number."""
_SHOWN_AS: Final[Mapping[str, str]] = {"degC": "°C", "um": "µm"}
_CEFACT = "http://www.opcfoundation.org/UA/units/un/cefact"
_BUILT_IN: Final[Mapping[str, ua.VariantType]] = {
    "Double": ua.VariantType.Double,
    "String": ua.VariantType.String,
    "String[]": ua.VariantType.String,
    "LocalizedText": ua.VariantType.LocalizedText,
    "DateTime": ua.VariantType.DateTime,
    "UInt16": ua.VariantType.UInt16,
    "UInt32": ua.VariantType.UInt32,
    "NodeId": ua.VariantType.NodeId,
}
_DATA_TYPES: Final[Mapping[str, int]] = {"DateTime": 294}
"""Where it is not the number of the built-in type: UtcTime."""
_MOST_VARIABLES = 1000
"""Most variables of a machine, which anybody who may publish can make this process keep."""
_PROFILES: Final = 2269
_NAMESPACES: Final = 11715
"""ServerProfileArray of the server's capabilities, and the folder of its namespaces."""
_READ = ua.AccessLevel.CurrentRead.mask


class AddressSpace:
    """What the server's clients see. All nodes are read-only.

    Parameters
    ----------
    server: where the nodes are
    indexes: of the namespaces
    """

    def __init__(self, server: InternalServer, indexes: Mapping[Space, int]) -> None:
        self._server, self._indexes = server, {**indexes, "base": 0}
        self._variables: dict[str, dict[Path, tuple[ua.NodeId, NodeSpec]]] = {}
        self._shown: dict[tuple[str, Path], NodeShown] = {}

    async def add_types(self) -> None:
        """The types, and the folder of the machines."""
        for spec in OBJECT_TYPES:
            attributes = ua.ObjectTypeAttributes(IsAbstract=spec.abstract)
            await self._add((spec.space, spec.number), spec.space, spec.name, spec.above, 45, attributes)
        mode: Id = ("machine_tool", OPERATION_MODE)
        await self._add(mode, "machine_tool", "MachineOperationMode", ("base", 29), 45, ua.DataTypeAttributes())
        values = [ua.EnumValueType(i, ua.LocalizedText(name)) for i, name in enumerate(OPERATION_MODES)]
        await self._property(self._id(mode), "EnumValues", ua.Variant(values), 7594)
        machines: Id = ("machinery", MACHINES_NODE)
        await self._add(machines, "machinery", "Machines", ("base", 85), 35, ua.ObjectAttributes(), ("base", 61))

    async def describe(self, profiles: Sequence[str]) -> None:
        """What the server conforms to, and its namespaces (OPC UA Part 5, 6.3.13 and 6.3.14)."""
        await self._set(_base(_PROFILES), NodeShown(None, GOOD, datetime.now(UTC)), ua.Variant(list(profiles)))
        for space, uri in URIS.items():
            node = self._own(f"Namespaces/{uri}")
            metadata: Id = ("base", 11616)
            await self._add(node, space, uri, _base(_NAMESPACES), 47, ua.ObjectAttributes(), metadata)
            numeric = space != "own"
            for name, value, data_type in (
                ("NamespaceUri", ua.Variant(uri), 12),
                ("NamespaceVersion", ua.Variant(None, ua.VariantType.String), 12),
                ("NamespacePublicationDate", ua.Variant(None, ua.VariantType.DateTime), 13),
                ("IsNamespaceSubset", ua.Variant(numeric), 1),  # of a published one only what machines need is there
                ("StaticNodeIdTypes", ua.Variant([int(not numeric)], ua.VariantType.Int32), 256),
                ("StaticNumericNodeIdRange", ua.Variant([], ua.VariantType.String, is_array=True), 291),
                ("StaticStringNodeIdPattern", ua.Variant("" if numeric else ".*"), 12),
            ):
                await self._property(node, name, value, data_type)

    async def add_machine(self, spec: NodeSpec) -> None:
        """All nodes of one machine, without a value yet."""
        await self._node(spec.name, self._id(("machinery", MACHINES_NODE)), spec, spec.name, 35)

    async def show(self, machine: str, values: Mapping[Path, NodeShown], units: Mapping[str, str]) -> None:
        """Write what has changed.

        units: by channel; a channel that is new here gets its node
        """
        variables = self._variables[machine]
        for path in values:
            if path not in variables and path[0] == CHANNELS and len(variables) < _MOST_VARIABLES:
                await self._channel(machine, path, units.get(path[1], ""))
        for path, known in variables.items():
            shown = values.get(path, UNKNOWN)
            if self._shown.get((machine, path)) != shown:
                await self._write(known, shown)
                self._shown[machine, path] = shown

    async def _channel(self, machine: str, path: Path, unit: str) -> None:
        parent = f"{machine}/Monitoring/Channels"
        await self._node(machine, self._own(parent), quantity(path[1], unit, path), f"{parent}/{path[1]}", 47)

    async def _node(self, machine: str, parent: ua.NodeId, spec: NodeSpec, place: str, reference: int) -> None:
        """One node and those below it. place: its own identifier, the names from the machine on"""
        node = self._own(place)
        await self._add(node, spec.space, spec.name, parent, reference, self._attributes(spec), spec.kind)
        if spec.shows is not None:
            self._variables.setdefault(machine, {})[spec.shows] = node, spec
        if spec.unit:
            text = ua.LocalizedText(_SHOWN_AS.get(spec.unit, spec.unit))
            number, name = _UNITS.get(spec.unit, (-1, spec.unit))
            unit = ua.EUInformation(_CEFACT, number, text, ua.LocalizedText(name))
            await self._property(node, "EngineeringUnits", ua.Variant(unit), 887)
        for below in spec.below:
            kind = 46 if below.kind == PROPERTY else 47
            await self._node(machine, node, below, f"{place}/{below.name}", kind)

    def _attributes(self, spec: NodeSpec) -> ua.ObjectAttributes | ua.VariableAttributes:
        if not spec.data:
            return ua.ObjectAttributes()
        data = spec.data
        kind = self._id(data) if isinstance(data, tuple) else _base(_DATA_TYPES.get(data, _BUILT_IN[data].value))
        value = ua.Variant() if spec.fixed is None else _variant(spec.fixed, str(data))
        array = data == "String[]"
        return ua.VariableAttributes(
            Value=value,
            DataType=kind,
            ValueRank=ua.ValueRank.OneDimension if array else ua.ValueRank.Scalar,
            AccessLevel=_READ,
            UserAccessLevel=_READ,
        )

    async def _add(
        self,
        node: Id | ua.NodeId,
        space: Space,
        name: str,
        parent: Id | ua.NodeId,
        reference: int,
        attributes: ua.ObjectAttributes | ua.VariableAttributes | ua.ObjectTypeAttributes | ua.DataTypeAttributes,
        kind: Id | None = None,
    ) -> None:
        attributes.DisplayName = ua.LocalizedText(name)
        item = ua.AddNodesItem(
            ParentNodeId=parent if isinstance(parent, ua.NodeId) else self._id(parent),
            ReferenceTypeId=_base(reference),
            RequestedNewNodeId=node if isinstance(node, ua.NodeId) else self._id(node),
            BrowseName=ua.QualifiedName(name, self._indexes[space]),
            NodeClass=_CLASSES[type(attributes)],
            NodeAttributes=attributes,
            TypeDefinition=ua.NodeId() if kind is None else self._id(kind),
        )
        (result,) = await self._server.isession.add_nodes([item])
        result.StatusCode.check()
        if isinstance(attributes, ua.VariableAttributes) and attributes.Value.Value is None:
            await self._set(item.RequestedNewNodeId, NodeShown(None, NOT_KNOWN, None), ua.Variant())

    async def _property(self, parent: ua.NodeId, name: str, value: ua.Variant, data_type: int) -> None:
        attributes = ua.VariableAttributes(
            Value=value,
            DataType=_base(data_type),
            ValueRank=ua.ValueRank.OneDimension if isinstance(value.Value, list) else ua.ValueRank.Scalar,
            AccessLevel=_READ,
            UserAccessLevel=_READ,
        )
        await self._add(self._own(f"{parent.Identifier!s}/{name}"), "base", name, parent, 46, attributes, PROPERTY)

    async def _write(self, known: tuple[ua.NodeId, NodeSpec], shown: NodeShown) -> None:
        node, spec = known
        value = ua.Variant() if shown.value is None else _variant(shown.value, str(spec.data))
        await self._set(node, shown, value)

    async def _set(self, node: ua.NodeId, shown: NodeShown, value: ua.Variant) -> None:
        data = ua.DataValue(
            Value=value,
            StatusCode=ua.StatusCode(getattr(StatusCodes, shown.status)),
            SourceTimestamp=cast(ua.DateTime | None, shown.at),
            ServerTimestamp=cast(ua.DateTime, datetime.now(UTC)),
        )
        (await self._server.aspace.write_attribute_value(node, AttributeIds.Value, data)).check()

    def _id(self, of: Id) -> ua.NodeId:
        return ua.NodeId(ua.Int32(of[1]), ua.Int16(self._indexes[of[0]]))

    def _own(self, place: str) -> ua.NodeId:
        return ua.NodeId(ua.String(place), ua.Int16(self._indexes["own"]))


def _base(number: int) -> ua.NodeId:
    """A node of OPC UA itself."""
    return ua.NodeId(ua.Int32(number))


_CLASSES = {
    ua.ObjectAttributes: ua.NodeClass.Object,
    ua.VariableAttributes: ua.NodeClass.Variable,
    ua.ObjectTypeAttributes: ua.NodeClass.ObjectType,
    ua.DataTypeAttributes: ua.NodeClass.DataType,
}


def _variant(value: object, data: str) -> ua.Variant:
    if data == "LocalizedText":
        value = ua.LocalizedText(str(value))
    elif isinstance(value, tuple):
        value = list(value)
    return ua.Variant(value, _BUILT_IN[data], is_array=data == "String[]")
