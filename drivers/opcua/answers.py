"""Converts nodes and answers between the library's types and ours. Importing this loads asyncua."""

from collections.abc import Sequence
from datetime import datetime
from typing import Final

from asyncua.ua.uatypes import DataValue, NodeId

from drivers.opcua.nodes import NodeName, NodeValue

SERVER_TIME: Final = NodeId.from_string("i=2258")
"""Server_ServerStatus_CurrentTime, which every server has (Part 5, 6.3.1)."""
NAMESPACES: Final = NodeId.from_string("i=2255")
"""Server_NamespaceArray, which every server has."""
MOST_NODES: Final = NodeId.from_string("i=11705")
"""Server_ServerCapabilities_OperationLimits_MaxNodesPerRead, which a server may have (Part 5, 6.3.11)."""


def count_in(data: DataValue) -> int:
    """The value of a node that holds a count; 0 if it does not."""
    value = None if data.Value is None else data.Value.Value
    return value if isinstance(value, int) and value > 0 else 0


def names_in(data: DataValue) -> list[str]:
    """The value of a node that holds a list of names; empty where one is not a text."""
    value = None if data.Value is None else data.Value.Value
    return [name if isinstance(name, str) else "" for name in value] if isinstance(value, list) else []


def node_id(name: NodeName, namespaces: Sequence[str]) -> NodeId | None:
    """The node at a server with these namespaces; None in one that it does not have."""
    index = name.namespace
    if isinstance(index, str):
        if index not in namespaces:
            return None
        index = namespaces.index(index)
    return NodeId.from_string(f"ns={index};{name.identifier}")


def time_in(data: DataValue) -> datetime | None:
    """The value of a node that holds a time."""
    value = None if data.Value is None else data.Value.Value
    return value if isinstance(value, datetime) else None


def node_value(data: DataValue, now: datetime | None) -> NodeValue:
    """now: the server's present time, if ages are wanted"""
    measured = data.SourceTimestamp
    age_s = (now - measured).total_seconds() if now is not None and measured is not None else None
    value = data.Value.Value if data.Value is not None else None
    status = data.StatusCode
    code, name = (0, "Good") if status is None else (status.value, status.name)
    return NodeValue(value, code, name, measured, age_s)
