"""`talc-gateway inspect objects` and `inspect nodes`: CANopen objects and OPC UA nodes by hand. They only read."""

import asyncio
import struct
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

import click
from rich.table import Table

from drivers.base import Refused
from drivers.canopen import CanObject, CanOpenBus, CanOpenSettings
from drivers.number_types import BYTE_FORMATS, ByteNumber
from drivers.opcua import NodeName, NodeValue, OpcUaBus, OpcUaBusSettings, node_name
from drivers.problems import read_settings
from drivers.section import LONGEST_ANSWER_S
from gateway.acquisition.text import number_text
from gateway.cli.commissioning.inspection import Draft, new_file, now_text, write_draft
from gateway.cli.conventions.arguments import FiniteNumber, field_option
from gateway.cli.conventions.exits import EXIT_WORLD
from gateway.cli.conventions.terminal import printable, terminal
from gateway.commissioning.scan.drafts import node_draft, object_draft
from gateway.commissioning.scan.found import open_bus
from gateway.runtime.boundary import contained

_MOST_BYTES = 64
"""Largest size of an object that holds a text."""
_MOST_PLACES = 16
"""Most bytes of a node at which a number may begin."""
_KINDS: tuple[ByteNumber, ...] = (
    "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64",
)  # fmt: skip
"""What bytes are shown as; a truth value would be shown twice."""


class ObjectPlace(click.ParamType[CanObject]):
    """`2100:01`, both hexadecimal; without a sub-index: 0."""

    name = "object"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> CanObject:
        index, _, subindex = str(value).partition(":")
        try:
            found = CanObject(int(index, 16), int(subindex or "0", 16))
        except ValueError:
            self.fail(f"{value!r}: expected index:subindex in hexadecimal, such as 2100:01", param, ctx)
        if not (0x1000 <= found.index <= 0xFFFF and found.subindex <= 0xFF):
            self.fail(f"{value!r}: expected an index of 1000 to FFFF and a subindex of 00 to FF", param, ctx)
        return found


@click.command("objects")
@click.argument("channel")
@click.argument("node", type=click.IntRange(*CanOpenSettings.units))
@click.argument("objects", type=ObjectPlace(), nargs=-1, required=True)
@field_option("--interface", CanOpenSettings, "interface")
@field_option("--bitrate", CanOpenSettings, "bitrate")
@click.option("--timeout", "timeout_s", type=FiniteNumber(0.01, LONGEST_ANSWER_S), default=1.0, show_default=True)
@field_option("--udp-port", CanOpenSettings, "port", "For udp_multicast only.")
@Draft
@click.option("--type", "kind", type=click.Choice(_KINDS), help="Type of all these objects in the draft.")
@click.option(
    "--scale", type=FiniteNumber(), default=1.0, show_default=True, help="Scale in the draft: value = number * scale."
)
@click.option("--quantity", default="degC", show_default=True, help="Unit of the values in the draft.")
def objects_command(
    channel: str, node: int, objects: tuple[CanObject, ...], interface: str, bitrate: int, timeout_s: float,
    udp_port: int, draft: Path | None, kind: ByteNumber | None, scale: float, quantity: str,
) -> None:  # fmt: skip
    """Read OBJECTS (2100:01 6000) of one CANopen NODE by SDO. CHANNEL is can0, or the serial port of an slcan adapter.

    Shows every number that the bytes may be.
    """
    new_file(draft)
    if draft is not None and kind is None:
        raise click.UsageError("--draft needs --type: which of the numbers shown are the values?")
    place = {"interface": interface, "channel": channel, "bitrate": bitrate, "port": udp_port, "timeout_s": timeout_s}
    bus = CanOpenBus("inspect", read_settings(CanOpenSettings, place))
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
    if draft is not None and kind is not None and seen:
        size = struct.calcsize(BYTE_FORMATS[kind])
        fitting = {found: _number(data, kind) for found, data in seen.items() if len(data) == size}
        if not fitting:
            raise click.UsageError(f"--type {kind}: none of the objects has {size} bytes")
        where = f"node {node} at {channel}"
        text = object_draft(fitting, kind=kind, scale=scale, unit=quantity, place=where, when=now_text())
        write_draft(draft, text, node)
    sys.exit(0 if seen else EXIT_WORLD)


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
    return [kind for kind in _KINDS if struct.calcsize(BYTE_FORMATS[kind]) in sizes]


def _number(data: bytes, kind: ByteNumber, order: Literal["<", ">"] = "<") -> str:
    """Empty if the bytes are not as many as the type has.

    order: `<`, the least significant byte first, as in CANopen
    """
    form = struct.Struct(order + BYTE_FORMATS[kind])
    if len(data) != form.size:
        return ""
    (number,) = form.unpack(data)
    return str(number) if isinstance(number, int) else number_text(number)


@click.command("nodes")
@click.argument("url")
@click.argument("nodes", nargs=-1, required=True)
@click.option("--user", help="User name; needs --password-file. Default: anonymous.")
@click.option("--password-file", help="File that contains only the user's password.")
@click.option("--certificate", help="The gateway's certificate; needs --private-key. Without it nothing is encrypted.")
@click.option("--private-key", help="The certificate's key.")
@click.option("--server-certificate", help="The server's certificate; no other is accepted.")
@click.option("--timeout", "timeout_s", type=FiniteNumber(0.01, LONGEST_ANSWER_S), default=5.0, show_default=True)
@Draft
@click.option("--type", "kind", type=click.Choice(_KINDS), help="How nodes of bytes hold numbers, for the draft.")
@click.option(
    "--scale", type=FiniteNumber(), default=1.0, show_default=True, help="Scale in the draft: value = number * scale."
)
@click.option("--quantity", default="degC", show_default=True, help="Unit of the values in the draft.")
def nodes_command(
    url: str, nodes: tuple[str, ...], user: str | None, password_file: str | None, certificate: str | None,
    private_key: str | None, server_certificate: str | None, timeout_s: float, draft: Path | None, kind: str | None,
    scale: float, quantity: str,
) -> None:  # fmt: skip
    """Read NODES ('ns=2;s=/Plc/MW200' i=2258) of the OPC UA server at URL (opc.tcp://host:4840).

    Shows value, type, status and age by the server's own clock; for a node of bytes, such as the process data of an
    IO-Link device, also the numbers that the bytes may be.
    """
    new_file(draft)
    given: dict[str, object] = {
        "url": url, "user": user, "password_file": password_file, "certificate": certificate,
        "private_key": private_key, "server_certificate": server_certificate, "timeout_s": timeout_s,
        "security": "none" if certificate is None else "Basic256Sha256",
    }  # fmt: skip
    settings = read_settings(OpcUaBusSettings, {key: value for key, value in given.items() if value is not None})
    try:
        names = [node_name(text) for text in nodes]
    except ValueError as error:
        raise click.UsageError(f"{error}; expected such as 'ns=2;s=/Plc/MW200', i=2258, nsu=urn:maker;s=T1") from error
    bus = OpcUaBus("inspect", settings)
    found = asyncio.run(_read_nodes(bus, names))
    table = Table("node", "value", "type", "status", "age", title=printable(url), title_justify="left")
    for name, one in zip(nodes, found, strict=True):
        age = "" if one.age_s is None else f"{one.age_s:.0f} s"
        python_type = "" if one.value is None else type(one.value).__name__
        table.add_row(printable(name), printable(repr(one.value)[:60]), python_type, one.status_name, age)
    terminal().print(table)
    good = {name: one for name, one in zip(nodes, found, strict=True) if one.fault() is None}
    data = {name: one.data for name, one in good.items() if one.data}
    for name, bytes_held in data.items():
        terminal().print(_bytes_table(name, bytes_held))
    numbers: dict[str, object] = {n: one.value for n, one in good.items() if isinstance(one.value, int | float)}
    if draft is not None:
        drafted = numbers | (data if kind is not None else {})
        if not drafted:
            hint = "; --type says how its bytes hold one" if data else ""
            raise click.UsageError(f"no node holds a good number{hint}: no draft was written")
        text = node_draft(drafted, scale=scale, unit=quantity, place=url, when=now_text(), kind=kind)
        write_draft(draft, text, 1)
    sys.exit(0 if numbers or data else EXIT_WORLD)


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


async def _read_nodes(bus: OpcUaBus, names: Sequence[NodeName]) -> list[NodeValue]:
    async with open_bus(bus):
        return await contained(bus.read("", names, aged=True), "the request")
