"""The types, NodeIds and mandatory nodes are those of the OPC Foundation's own files, which node-opcua ships."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from xml.etree import ElementTree

import pytest

from gateway.listeners.umati.model import (
    MACHINES_NODE,
    OBJECT_TYPES,
    OPERATION_MODE,
    OPERATION_MODES,
    PROPERTY,
    URIS,
    NodeSpec,
    Space,
    TypeSpec,
    machine_nodes,
)
from gateway.listeners.umati.settings import ShownMachine
from tests.benches.npm_peer import PEERS, node_with

pytestmark = pytest.mark.peer

FILES = {"di": "Opc.Ua.Di", "machinery": "Opc.Ua.Machinery", "machine_tool": "Opc.Ua.MachineTool"}
BASE = "http://opcfoundation.org/UA/"
TAG = "{http://opcfoundation.org/UA/2011/03/UANodeSet.xsd}"
PUBLISHED = tuple[str, int]
"""Namespace URI and number."""
SUBTYPE, KIND, RULE, MANDATORY = (BASE, 45), (BASE, 40), (BASE, 37), (BASE, 78)


@dataclass
class PublishedNode:
    """One node of a file."""

    name: tuple[str, str]
    abstract: bool
    tag: str
    above: PUBLISHED | None = None
    kind: PUBLISHED | None = None
    mandatory: bool = False
    below: list[PUBLISHED] = field(default_factory=list)


@cache
def published() -> dict[PUBLISHED, PublishedNode]:
    """All nodes of the three files."""
    node_with("node_opcua", "node-opcua")
    folder = PEERS / "node_opcua" / "node_modules" / "node-opcua-nodesets" / "nodesets"
    found: dict[PUBLISHED, PublishedNode] = {}
    for name in FILES.values():
        found |= NodeSetFile(ElementTree.parse(folder / f"{name}.NodeSet2.xml").getroot()).nodes()
    return found


class NodeSetFile:
    """A file's names and numbers.

    Parameters
    ----------
    root: of the file
    """

    def __init__(self, root: ElementTree.Element) -> None:
        self._root = root
        self._uris = [BASE, *(uri.text or "" for uri in root.iter(f"{TAG}Uri"))]
        self._aliases = {alias.get("Alias"): alias.text or "" for alias in root.iter(f"{TAG}Alias")}

    def number(self, text: str) -> PUBLISHED:
        space, _, rest = self._aliases.get(text, text).rpartition(";")
        return self._uris[int(space.removeprefix("ns=") or 0)], int(rest.removeprefix("i="))

    def name(self, text: str) -> tuple[str, str]:
        space, colon, rest = text.partition(":")
        return (self._uris[int(space)], rest) if colon and space.isdecimal() else (BASE, text)

    def nodes(self) -> dict[PUBLISHED, PublishedNode]:
        """All, each with the mandatory and optional ones below it."""
        elements = [element for element in self._root if element.get("NodeId") is not None]
        found = {self.number(element.get("NodeId", "")): self._node(element) for element in elements}
        for element in elements:
            if (parent := element.get("ParentNodeId")) is not None and self.number(parent) in found:
                found[self.number(parent)].below.append(self.number(element.get("NodeId", "")))
        return found

    def _node(self, element: ElementTree.Element) -> PublishedNode:
        name, tag = self.name(element.get("BrowseName", "")), element.tag.removeprefix(TAG)
        node = PublishedNode(name, element.get("IsAbstract") == "true", tag)
        for reference in element.iter(f"{TAG}Reference"):
            kind, to = self.number(reference.get("ReferenceType", "")), self.number(reference.text or "")
            if kind == SUBTYPE and reference.get("IsForward") == "false":
                node.above = to
            elif kind == KIND:
                node.kind = to
            elif kind == RULE:
                node.mandatory = to == MANDATORY
        return node


def of(space: Space, number: int) -> PUBLISHED:
    return BASE if space == "base" else URIS[space], number


def demanded(kind: PUBLISHED | None) -> Iterator[PublishedNode]:
    """The mandatory nodes below an instance of a type, those of the types above it included."""
    nodes = published()
    while kind in nodes:
        yield from (nodes[child] for child in nodes[kind].below if nodes[child].mandatory)
        kind = nodes[kind].above


def instances(spec: NodeSpec) -> Iterator[NodeSpec]:
    yield spec
    for below in spec.below:
        yield from instances(below)


MILL = machine_nodes("mill", ShownMachine(model="X5", location="hall 2"))


@pytest.mark.parametrize("spec", OBJECT_TYPES, ids=lambda spec: spec.name)
def test_a_type_is_as_it_was_published(spec: TypeSpec) -> None:
    node = published()[of(spec.space, spec.number)]
    assert (node.name, node.tag) == ((URIS[spec.space], spec.name), "UAObjectType")
    assert (node.above, node.abstract) == (of(*spec.above), spec.abstract)


def test_the_folder_and_the_modes_have_their_published_numbers() -> None:
    found = published()
    assert found[of("machinery", MACHINES_NODE)].name == (URIS["machinery"], "Machines")
    mode = found[of("machine_tool", OPERATION_MODE)]
    assert (mode.name[1], mode.tag) == ("MachineOperationMode", "UADataType")
    root = ElementTree.parse(
        PEERS / "node_opcua/node_modules/node-opcua-nodesets/nodesets/Opc.Ua.MachineTool.NodeSet2.xml"
    )
    values = next(e for e in root.getroot() if e.get("ParentNodeId") == f"ns=1;i={OPERATION_MODE}")
    types = "{http://opcfoundation.org/UA/2008/02/Types.xsd}"
    told = [name.findtext(f"{types}Text") for name in values.iter(f"{types}DisplayName")]
    assert tuple(told) == OPERATION_MODES


def test_each_instance_has_all_that_its_type_demands() -> None:
    missing = []
    checked = 0
    for spec in instances(MILL):
        below = {(of(b.space, 0)[0], b.name): b for b in spec.below}
        for node in demanded(of(*spec.kind)):
            checked += 1
            there = below.get(node.name)
            if there is None:
                missing.append((spec.name, node.name))
                continue
            assert bool(there.data) == (node.tag == "UAVariable"), node.name
            if there.kind[0] != "base" or there.kind == PROPERTY:
                assert of(*there.kind) == node.kind, node.name
    assert checked > 15
    assert missing == []


def test_what_bears_a_published_name_is_in_its_type() -> None:
    """No node uses a name of a companion specification that its parent's type does not have."""
    nodes = published()
    for spec in instances(MILL):
        allowed = set()
        kind: PUBLISHED | None = of(*spec.kind)
        while kind in nodes:
            allowed |= {nodes[child].name for child in nodes[kind].below}
            kind = nodes[kind].above
        for below in spec.below:
            if below.space not in ("own", "base") and spec.kind[0] != "base":
                assert (URIS[below.space], below.name) in allowed, (spec.name, below.name)
