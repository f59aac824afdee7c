"""Profiles of OPC UA servers: which nodes are channels."""

from functools import cached_property
from typing import ClassVar, Literal

from pydantic import Field

from drivers.opcua.nodes import NodeName, NodeText, node_name
from drivers.profile import DeviceProfile, LinearValue
from drivers.section import NotEmpty, Positive


class OpcUaNode(LinearValue):
    """One channel: value = number of the node * scale + offset."""

    node: NodeText
    """The node's id. Without `ns=` or `nsu=` it is in the profile's `namespace`."""
    element: int | None = Field(default=None, ge=0)
    """Which element of an array, counted from 0; None: the node holds one number."""


class OpcUaProfile(DeviceProfile):
    """Nodes of an OPC UA server."""

    buses: ClassVar[tuple[str, ...]] = ("opcua",)

    protocol: Literal["opcua"]
    """`opcua`."""
    namespace: NotEmpty | None = None
    """URI of the namespace of nodes that state none; its index is looked up at every connect."""
    max_age_s: Positive | None = None
    """A value whose source timestamp is older than this, by the server's own clock, is `stale`. Only for servers that
    renew the timestamp of a value that stays the same; None: not checked."""
    nodes: tuple[OpcUaNode, ...] = Field(alias="node", min_length=1)

    @property
    def channels(self) -> int:
        """Number of channels."""
        return len(self.nodes)

    @cached_property
    def names(self) -> tuple[NodeName, ...]:
        """The node of each channel."""
        return tuple(node_name(node.node, self.namespace) for node in self.nodes)
