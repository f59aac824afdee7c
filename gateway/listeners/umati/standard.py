"""The nodes that every OPC UA server has, packed: as objects the library's 6174 take 52 MB, and clients ask for few."""

import hashlib
import logging
import pickle
import zlib
from collections import OrderedDict
from collections.abc import Iterator, Mapping, MutableMapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from asyncua import ua
from asyncua.server.address_space import AddressSpace, NodeData, NodeManagementService
from asyncua.server.internal_server import InternalServer

from gateway.model.codes import NoticeCode
from gateway.model.text import Text, text_of
from gateway.runtime.workers.process import WorkError, in_process

log = logging.getLogger(__name__)

_TOGETHER = 16
"""Nodes in a pack: neighbours by number are often asked for together."""
_MOST_OPEN = 40
"""Packs that are open at a time, beside those in which something has changed."""


@dataclass(frozen=True, slots=True)
class NodePack:
    """Nodes of OPC UA's own namespace, which have numbers."""

    numbers: tuple[int, ...]
    nodes: bytes
    """Pickled and compressed, in the same order."""

    def opened(self) -> list[NodeData]:
        """The nodes, as new objects."""
        found: list[NodeData] = pickle.loads(zlib.decompress(self.nodes))
        return found


def pack_standard() -> list[NodePack]:
    """Make what the library makes of the published nodes, and pack it. Takes seconds, and memory: work for a separate
    process."""
    from asyncua.server.standard_address_space.standard_address_space import fill_address_space

    space = AddressSpace()
    fill_address_space(NodeManagementService(space))  # type: ignore[no-untyped-call]
    found = space.keys()
    numbers = sorted(int(node_id.Identifier) for node_id in found)
    groups = [tuple(numbers[at : at + _TOGETHER]) for at in range(0, len(numbers), _TOGETHER)]
    return [
        NodePack(group, zlib.compress(pickle.dumps([space[ua.NodeId(ua.Int32(n))] for n in group]))) for group in groups
    ]


class ServedNodes(MutableMapping[ua.NodeId, NodeData]):
    """All nodes of a server. A pack is opened when one of its nodes is asked for. When many others have been opened
    since, it is closed again, unless one of its nodes has changed or somebody is told of its changes."""

    def __init__(self, packs: Sequence[NodePack]) -> None:
        self._packs = packs
        self._pack_of = {number: at for at, pack in enumerate(packs) for number in pack.numbers}
        self._kept: dict[ua.NodeId, NodeData] = {}
        self._open = OrderedDict[int, tuple[bytes, dict[int, NodeData]]]()
        """By pack, the one that was asked for last at the end: what it was when it was opened, and its nodes."""

    def __getitem__(self, key: ua.NodeId) -> NodeData:
        kept = self._kept.get(key)
        if kept is not None:
            return kept
        number = _standard_number(key)
        if number not in self._pack_of:
            raise KeyError(key)
        return self._opened(self._pack_of[number])[number]

    def __setitem__(self, key: ua.NodeId, value: NodeData) -> None:
        self._pack_of.pop(_standard_number(key), None)
        self._kept[key] = value

    def __delitem__(self, key: ua.NodeId) -> None:
        packed = self._pack_of.pop(_standard_number(key), None) is not None
        if self._kept.pop(key, None) is None and not packed:
            raise KeyError(key)

    def __contains__(self, key: object) -> bool:
        return key in self._kept or (isinstance(key, ua.NodeId) and _standard_number(key) in self._pack_of)

    def __iter__(self) -> Iterator[ua.NodeId]:
        yield from self._kept
        yield from [ua.NodeId(ua.Int32(number)) for number in self._pack_of]

    def __len__(self) -> int:
        return len(self._kept) + len(self._pack_of)

    @property
    def objects(self) -> int:
        """How many nodes are objects at present."""
        return len(self._kept) + sum(len(nodes) for _, nodes in self._open.values())

    def _opened(self, at: int) -> dict[int, NodeData]:
        if at in self._open:
            self._open.move_to_end(at)
            return self._open[at][1]
        pack = self._packs[at]
        nodes = dict(zip(pack.numbers, pack.opened(), strict=True))
        self._open[at] = _state(nodes), nodes
        if len(self._open) > _MOST_OPEN:
            self._close(*self._open.popitem(last=False)[1])
        return nodes

    def _close(self, was: bytes, nodes: dict[int, NodeData]) -> None:
        if any(map(_is_watched, nodes.values())) or _state(nodes) != was:
            for number, node in nodes.items():
                if self._pack_of.pop(number, None) is not None:  # else it was deleted or replaced
                    self._kept[ua.NodeId(ua.Int32(number))] = node


def _standard_number(key: ua.NodeId) -> int:
    """The number of a node that can be in a pack; otherwise -1."""
    identifier = key.Identifier
    return int(identifier) if key.NamespaceIndex == 0 and isinstance(identifier, int) else -1


def _is_watched(node: NodeData) -> bool:
    """Whether it calls somebody, when it is read, written or called."""
    return node.call is not None or any(
        value.datachange_callbacks or value.value_callback or value.value_setter for value in node.attributes.values()
    )


def _state(nodes: Mapping[int, NodeData]) -> bytes:
    return hashlib.blake2b(pickle.dumps(list(nodes.values())), digest_size=16).digest()


def serve_packed(space: AddressSpace, packs: Sequence[NodePack]) -> ServedNodes:
    """Let these be the nodes of an address space, as the library does with the file of nodes that it can write."""
    nodes = ServedNodes(packs)
    space._nodes = nodes  # type: ignore[assignment]  # noqa: SLF001 - the library offers no other way
    return nodes


class LightServer(InternalServer):
    """The library's server, with its nodes packed."""

    async def load_standard_address_space(self, shelf_file: Path | None = None) -> None:
        """As in the library, in a process beside."""
        try:
            packs = await in_process(pack_standard)
        except WorkError as error:
            log.warning("%s", Text(NoticeCode.NODES_NOT_PACKED, why=text_of(error)))
            await super().load_standard_address_space(shelf_file)
        else:
            serve_packed(self.aspace, packs)
