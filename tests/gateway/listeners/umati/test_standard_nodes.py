"""The packed nodes of the OPC UA standard are those that the library makes, and what is changed in them stays."""

from asyncio import run
from collections.abc import Sequence

import pytest
from asyncua import ua
from asyncua.server.address_space import AddressSpace, NodeData, NodeManagementService
from asyncua.server.standard_address_space.standard_address_space import fill_address_space
from asyncua.ua.attribute_ids import AttributeIds

from gateway.listeners.umati.standard import NodePack, ServedNodes, pack_standard, serve_packed

pytestmark = pytest.mark.slow  # the pack of the standard takes three seconds to make


def node_id(of: int | str, namespace: int = 0) -> ua.NodeId:
    return ua.NodeId(ua.String(of) if isinstance(of, str) else ua.Int32(of), ua.Int16(namespace))


SERVER_ARRAY, SERVER_STATUS = node_id(2254), node_id(2256)


@pytest.fixture(scope="module")
def packs() -> Sequence[NodePack]:
    return pack_standard()


@pytest.fixture
def space() -> AddressSpace:
    return AddressSpace()


@pytest.fixture
def nodes(space: AddressSpace, packs: Sequence[NodePack]) -> ServedNodes:
    """The server's own nodes, and more packs beside theirs than are open at a time."""
    own = next(at for at, pack in enumerate(packs) if SERVER_ARRAY.Identifier in pack.numbers)
    return serve_packed(space, packs[own - 30 : own + 30])


def read_all(nodes: ServedNodes) -> None:
    for key in nodes:
        assert nodes[key].attributes


def held(node: NodeData) -> object:
    attributes = {k: (a.value, a.value_callback, a.value_setter) for k, a in node.attributes.items()}
    return node.nodeid, attributes, node.references, node.call


def test_the_nodes_are_as_the_library_makes_them(space: AddressSpace, packs: Sequence[NodePack]) -> None:
    nodes, plain = serve_packed(space, packs), AddressSpace()
    fill_address_space(NodeManagementService(plain))  # type: ignore[no-untyped-call]
    assert len(nodes) > 6000
    assert set(nodes) == set(plain.keys())
    for pack in packs[::5]:
        for key in map(node_id, pack.numbers):
            assert held(nodes[key]) == held(plain[key])


def test_a_client_that_reads_everything_takes_little_memory(space: AddressSpace, packs: Sequence[NodePack]) -> None:
    nodes = serve_packed(space, packs)
    read_all(nodes)
    assert 0 < nodes.objects < len(nodes) / 5


def test_a_written_value_stays_when_its_pack_would_be_closed(space: AddressSpace, nodes: ServedNodes) -> None:
    value = ua.DataValue(ua.Variant(["urn:here"]))
    run(space.write_attribute_value(SERVER_ARRAY, AttributeIds.Value, value)).check()
    read_all(nodes)
    found = space.read_attribute_value(SERVER_ARRAY, AttributeIds.Value).Value
    assert found is not None
    assert found.Value == ["urn:here"]


def test_a_subscriber_of_a_node_is_told_after_its_pack_would_be_closed(space: AddressSpace, nodes: ServedNodes) -> None:
    told = list[object]()

    async def tell(_handle: int, value: ua.DataValue, _error: object = None) -> None:
        told.append(value)

    status, _ = space.add_datachange_callback(SERVER_ARRAY, AttributeIds.Value, tell)
    status.check()
    read_all(nodes)
    value = ua.DataValue(ua.Variant(["urn:here"]))
    run(space.write_attribute_value(SERVER_ARRAY, AttributeIds.Value, value)).check()
    assert told == [value]


def test_a_reference_added_to_a_node_stays(nodes: ServedNodes) -> None:
    was = len(nodes[SERVER_STATUS].references)
    nodes[SERVER_STATUS].references.append(ua.ReferenceDescription())
    read_all(nodes)
    assert len(nodes[SERVER_STATUS].references) == was + 1


def test_nodes_can_be_added_replaced_and_deleted(nodes: ServedNodes) -> None:
    count, own = len(nodes), node_id("mill", 5)
    assert own not in nodes
    nodes[own] = NodeData(own)
    assert own in nodes
    replaced = nodes[SERVER_ARRAY] = NodeData(SERVER_ARRAY)
    del nodes[SERVER_STATUS]
    read_all_but_new = [nodes[key] for key in nodes]
    assert len(read_all_but_new) == len(nodes) == count
    assert nodes[SERVER_ARRAY] is replaced
    assert SERVER_STATUS not in nodes
    for gone in (SERVER_STATUS, node_id("nothing", 5), node_id(999_999), node_id(2254, 3)):
        with pytest.raises(KeyError):
            nodes[gone]
        with pytest.raises(KeyError):
            del nodes[gone]
    del nodes[own]
    assert own not in nodes
