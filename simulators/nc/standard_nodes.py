"""OPC UA's standard nodes, made once per process: every server needs them, and making them takes 1.5 s."""

import asyncio
from collections.abc import Iterator, Mapping, MutableMapping
from copy import copy, deepcopy
from functools import cache
from pathlib import Path

from asyncua.server.address_space import AddressSpace, AttributeValue, NodeData, NodeManagementService
from asyncua.server.internal_server import InternalServer
from asyncua.server.standard_address_space import standard_address_space
from asyncua.server.user_managers import UserManager
from asyncua.ua.uatypes import LocalizedText, NodeId, QualifiedName

from simulators.nc.subscriptions import Subscriptions


class StandardServer(InternalServer):
    """A server of the library that copies the standard nodes it uses, and whose subscriptions can be made to fail."""

    def __init__(self, users: UserManager) -> None:
        super().__init__(users)
        self.subscriptions = Subscriptions(self.aspace, self)
        self.subscription_service = self.subscriptions

    async def load_standard_address_space(self, shelf_file: Path | None = None) -> None:  # noqa: ARG002
        """Instead of making them again. As in the library's own loading from a shelf, nodes come when they are used."""
        standard = await asyncio.to_thread(_standard)
        self.aspace._nodes = _Copied(standard)  # type: ignore[assignment]  # noqa: SLF001


@cache
def _standard() -> Mapping[NodeId, NodeData]:
    space = AddressSpace()
    standard_address_space.fill_address_space(NodeManagementService(space))  # type: ignore[no-untyped-call]
    return {key: space[key] for key in space.keys()}  # noqa: SIM118 - it is not a mapping


_REPLACED = (bool, int, float, str, bytes, type(None), NodeId, QualifiedName, LocalizedText)
"""Values that the library replaces whole; it appends to lists, such as that of the namespaces."""


def _copy(node: NodeData) -> NodeData:
    """A node whose values, callbacks and references can change without the original; `deepcopy` of all of it would take
    almost half of a server's start."""
    copied = NodeData(node.nodeid)
    copied.attributes = {key: _copy_value(attribute) for key, attribute in node.attributes.items()}
    copied.references = [copy(reference) for reference in node.references]  # the library renames within them
    copied.call = node.call
    return copied


def _copy_value(attribute: AttributeValue) -> AttributeValue:
    copied = copy(attribute)
    copied.datachange_callbacks = dict(attribute.datachange_callbacks)
    variant = None if attribute.value is None else attribute.value.Value
    if variant is not None and not isinstance(variant.Value, _REPLACED):
        copied.value = deepcopy(attribute.value)
    return copied


class _Copied(MutableMapping[NodeId, NodeData]):
    """The nodes of one server: the first access to a standard node copies it."""

    def __init__(self, standard: Mapping[NodeId, NodeData]) -> None:
        self._left, self._own = dict(standard), dict[NodeId, NodeData]()

    def __getitem__(self, key: NodeId) -> NodeData:
        if key in self._left:
            self._own[key] = _copy(self._left.pop(key))
        return self._own[key]

    def __setitem__(self, key: NodeId, node: NodeData) -> None:
        self._left.pop(key, None)
        self._own[key] = node

    def __delitem__(self, key: NodeId) -> None:
        if self._left.pop(key, None) is None:
            del self._own[key]

    def __contains__(self, key: object) -> bool:
        return key in self._own or key in self._left

    def __iter__(self) -> Iterator[NodeId]:
        yield from (*self._left, *self._own)

    def __len__(self) -> int:
        return len(self._left) + len(self._own)
