"""CANopen objects and OPC UA nodes, read by hand: every number that their bytes may be, and the draft of a profile."""

import asyncio
import struct
from collections.abc import Mapping, Sequence
from typing import Literal

import click
from rich.table import Table

from drivers.base import Refused
from drivers.canopen.bus import CanOpenBus
from drivers.canopen.place import CanObject
from drivers.number_types import BYTE_FORMATS, ByteNumber
from drivers.opcua.bus import OpcUaBus
from drivers.opcua.nodes import NodeName, NodeValue, node_name
from gateway.acquisition.text import number_text
from gateway.commissioning.inspection.draft import Draft, now_text, write_draft
from gateway.commissioning.scan.drafts import BYTE_KINDS, node_draft, object_draft
from gateway.commissioning.scan.found import open_bus
from gateway.runtime.boundary import contained
from gateway.runtime.terminal import printable, terminal

_MOST_BYTES = 64
"""Largest size of an object that holds a text."""
_MOST_PLACES = 16
"""Most bytes of a node at which a number may begin."""


def inspect_objects(
    bus: CanOpenBus,
    node: int,
    objects: Sequence[CanObject],
    channel: str,
    draft: Draft,
    kind: ByteNumber | None,
) -> bool:
    """Read the objects, print a table and write the draft, which needs `kind`; False if nothing was read."""
    seen, refused = asyncio.run(_read_objects(bus, node, objects))
    table = Table("object", "bytes", *_columns(seen), "text", title=f"node {node}", title_justify="left")
    for found, data in seen.items():
        numbers = (_number(data, kind) for kind in _columns(seen))
        table.add_row(
            str(found), data[:8].hex(" "), *numbers, printable(data.decode("latin-1")) if len(data) > 8 else ""
        )
    console = terminal()
    if seen:
        console.print(table)
    for text in refused:
        console.print(f"- {text}", highlight=False, soft_wrap=True)
    if draft.file is not None and kind is not None and seen:
        size = struct.calcsize(BYTE_FORMATS[kind])
        fitting = {found: _number(data, kind) for found, data in seen.items() if len(data) == size}
        if not fitting:
            raise click.UsageError(f"--type {kind}: none of the objects has {size} bytes")
        where = f"node {node} at {channel}"
        text = object_draft(fitting, kind=kind, scale=draft.scale, unit=draft.quantity, place=where, when=now_text())
        write_draft(draft.file, text, node)
    return bool(seen)


def inspect_nodes(
    bus: OpcUaBus,
    nodes: Mapping[str, NodeName],
    url: str,
    draft: Draft,
    kind: str | None,
) -> bool:
    """Read the nodes, print the tables and write the draft; False if no node holds a number."""
    found = dict(zip(nodes, asyncio.run(_read_nodes(bus, list(nodes.values()))), strict=True))
    table = Table("node", "value", "type", "status", "age", title=printable(url), title_justify="left")
    for name, one in found.items():
        age = "" if one.age_s is None else f"{one.age_s:.0f} s"
        python_type = "" if one.value is None else type(one.value).__name__
        table.add_row(printable(name), printable(repr(one.value)[:60]), python_type, one.status_name, age)
    terminal().print(table)
    good = {name: one for name, one in found.items() if one.fault() is None}
    data = {name: one.data for name, one in good.items() if one.data}
    for name, bytes_held in data.items():
        terminal().print(_bytes_table(name, bytes_held))
    numbers: dict[str, object] = {n: one.value for n, one in good.items() if isinstance(one.value, int | float)}
    if draft.file is not None:
        drafted = {
            _by_uri(bus, nodes[name]): one for name, one in (numbers | (data if kind is not None else {})).items()
        }
        if not drafted:
            hint = "; --type says how its bytes hold one" if data else ""
            raise click.UsageError(f"no node holds a good number{hint}: no draft was written")
        text = node_draft(drafted, scale=draft.scale, unit=draft.quantity, place=url, when=now_text(), kind=kind)
        write_draft(draft.file, text, 1)
    return bool(numbers or data)


async def _read_objects(
    bus: CanOpenBus, node: int, objects: Sequence[CanObject]
) -> tuple[Mapping[CanObject, bytes], list[str]]:
    """What the node answers, and why it refuses the others. Raises DriverError when it does not answer."""
    seen: dict[CanObject, bytes] = {}
    refused: list[str] = []
    async with open_bus(bus):
        for wanted in dict.fromkeys(objects):
            try:
                (seen[wanted],) = await contained(bus.upload("", node, [wanted], _MOST_BYTES), f"object {wanted}")
            except Refused as error:
                refused.append(error.what)
    return seen, refused


def _columns(seen: Mapping[CanObject, bytes]) -> list[ByteNumber]:
    """The types that at least one of the objects has the size of."""
    sizes = {len(data) for data in seen.values()}
    return [kind for kind in BYTE_KINDS if struct.calcsize(BYTE_FORMATS[kind]) in sizes]


def _number(data: bytes, kind: ByteNumber, order: Literal["<", ">"] = "<") -> str:
    """Empty if the bytes are not as many as the type has.

    order: `<`, the least significant byte first, as in CANopen
    """
    form = struct.Struct(order + BYTE_FORMATS[kind])
    if len(data) != form.size:
        return ""
    (number,) = form.unpack(data)
    return str(number) if isinstance(number, int) else number_text(number)


def _bytes_table(name: str, data: bytes) -> Table:
    """The numbers that begin at each of the first bytes, with the most significant byte first."""
    kinds: tuple[ByteNumber, ...] = ("uint8", "int16", "int32", "float32")
    table = Table(
        "byte", "hex", "uint8", "int16", "x 0.1", "int32", "float32", title=printable(name), title_justify="left"
    )
    for first in range(min(len(data), _MOST_PLACES)):
        ends = (first + struct.calcsize(BYTE_FORMATS[kind]) for kind in kinds)
        byte, word, *wider = (_number(data[first:end], kind, ">") for kind, end in zip(kinds, ends, strict=True))
        tenth = f"{int(word) * 0.1:.1f}" if word else ""
        table.add_row(str(first), f"{data[first]:02X}", byte, word, tenth, *wider)
    return table


def _by_uri(bus: OpcUaBus, name: NodeName) -> str:
    """The node's name in a profile: an index is another namespace's if the server starts in another order."""
    text = str(bus.by_uri(name))
    try:
        node_name(text)
    except ValueError:  # a URI that cannot be written so
        return str(name)
    return text


async def _read_nodes(bus: OpcUaBus, names: Sequence[NodeName]) -> list[NodeValue]:
    async with open_bus(bus):
        return await contained(bus.read("", names, aged=True), "the request")
