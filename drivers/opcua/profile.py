"""Profiles of OPC UA servers: which nodes are channels."""

import struct
from functools import cached_property
from typing import ClassVar, Literal, Self

from pydantic import Field, model_validator

from drivers.faults import NumberRule, RawNumber
from drivers.number_types import BYTE_FORMATS, ByteNumber, check_shift, raw_number
from drivers.opcua.nodes import NodeName, NodeText, node_name
from drivers.profile import DeviceProfile, LinearValue
from drivers.section import NotEmpty, Positive, wrong
from drivers.text import Text


class OpcUaNode(LinearValue):
    """One channel: value = number of the node * scale + offset."""

    node: NodeText
    """The node's id. Without `ns=` or `nsu=` it is in the profile's `namespace`."""
    element: int | None = Field(default=None, ge=0)
    """Which element of an array, counted from 0; None: the node holds one number. With `type`: the number's first
    byte, by default 0."""
    type: ByteNumber | None = None
    """For a node that holds bytes, such as the process data of an IO-Link device: how they hold the number, the most
    significant byte first. None: the node holds numbers."""
    shift: int = Field(default=0, ge=0, le=63)
    """How many of the lowest bits of an integer with `type` mean something else; they are left out."""
    invalid: tuple[NumberRule, ...] = ()
    """With `type`: numbers, as sent but without the bits left out, that mean a fault, the most specific first."""

    @model_validator(mode="after")
    def _of_bytes(self) -> Self:
        if self.type is None:
            for field in ("shift", "invalid"):
                if field in self.model_fields_set:
                    raise wrong(Text("opcua_of_bytes"), field)
            return self
        check_shift(self.shift, self.type)
        for number, rule in enumerate(self.invalid):
            self.raw.check(rule, "invalid", number)
        return self

    @cached_property
    def raw(self) -> RawNumber:
        """What is left of a number of `type` without the bits that `shift` leaves out."""
        whole = raw_number(self.type or "uint64", self.node)
        return RawNumber(whole.name, whole.bits - self.shift, whole.signed, whole.real)

    @cached_property
    def form(self) -> struct.Struct | None:
        """How bytes hold the number; None: the node holds numbers."""
        return None if self.type is None else struct.Struct(">" + BYTE_FORMATS[self.type])


class OpcUaProfile(DeviceProfile):
    """Nodes of an OPC UA server."""

    buses: ClassVar[tuple[str, ...]] = ("opcua",)

    protocol: Literal["opcua"]
    """`opcua`."""
    namespace: NotEmpty | None = None
    """URI of the namespace of nodes that state none; its index is looked up at every connect."""
    max_age_s: Positive | None = None
    """A value whose source timestamp is older than this, by the server's own clock, is `stale`, and every other is as
    old as that says; at most three times `period_s` of the bus. Only for servers that renew the timestamp of a value
    that stays the same. None: not looked up; a value is as old as its reading."""
    nodes: tuple[OpcUaNode, ...] = Field(alias="node", min_length=1)

    @property
    def oldest_s(self) -> float | None:
        """`max_age_s`."""
        return self.max_age_s

    @property
    def channels(self) -> int:
        """Number of channels."""
        return len(self.nodes)

    @cached_property
    def names(self) -> tuple[NodeName, ...]:
        """The node of each channel."""
        return tuple(node_name(node.node, self.namespace) for node in self.nodes)
