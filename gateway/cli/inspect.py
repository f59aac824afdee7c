"""`talc-gateway inspect`: its commands `registers`, `sweep`, `objects`, `nodes` and `topics`."""

import sys
from functools import partial
from pathlib import Path
from typing import Any, get_args

import click

from drivers.canopen.place import CanObject
from drivers.canopen.settings import CanOpenSettings
from drivers.modbus.numbers import NumberFormat, NumberType
from drivers.modbus.settings import ModbusRtuSettings, ModbusTcpSettings
from drivers.mqtt.settings import MqttBusSettings
from drivers.number_types import ByteNumber
from drivers.problems import read_settings
from gateway.cli.arguments import AnyFile, FiniteNumber, Written, answer_timeout, field_option, gathered, numbers
from gateway.cli.exits import EXIT_WORLD
from gateway.commissioning.inspection.draft import Draft
from gateway.commissioning.scan.drafts import BYTE_KINDS

_MOST_ADDRESSES = 1000
with_draft = gathered(
    "draft",
    Draft,
    click.option("--draft", "file", type=AnyFile,
                 help="Write a profile of what was read; the file must not exist yet."),
    click.option("--scale", type=FiniteNumber(), default=1.0, show_default=True,
                 help="Scale in the draft: value = number * scale."),
    click.option("--quantity", default="degC", show_default=True, help="Unit of the values in the draft."),
)  # fmt: skip


timeout = partial(answer_timeout, "Seconds that one answer may take.")


with_form = gathered(
    "form",
    NumberFormat,
    click.option("--type", type=click.Choice(get_args(NumberType)), default="int16", show_default=True,
                 help="Type of the numbers in the draft."),
    click.option("--byte-order", type=click.Choice(["big", "little"]), default="big", show_default=True,
                 help="Byte order in the draft; little: bytes swapped."),
    click.option("--word-order", type=click.Choice(["big", "little"]), default="big", show_default=True,
                 help="Word order in the draft; little: words swapped."),
)  # fmt: skip


@click.command("registers")
@click.argument("where")
@click.argument("addresses", type=numbers(0, 65535))
@click.option(
    "--unit", type=click.IntRange(*ModbusTcpSettings.units), default=1, show_default=True, help="Modbus unit id."
)
@click.option("--function", type=click.Choice([1, 2, 3, 4]), default=3, show_default=True,
              help="1 and 2 read bits, 3 holding registers, 4 input registers.")  # fmt: skip
@field_option("--baud", ModbusRtuSettings, "baud")
@field_option("--parity", ModbusRtuSettings, "parity")
@click.option("--rtu", is_flag=True, help="RTU frames over TCP, for a device server; give its port.")
@timeout(1.0)
@with_form
@with_draft
def registers_command(
    where: str, addresses: tuple[int, ...], unit: int, function: int, form: NumberFormat, draft: Draft, **line: Any
) -> None:
    """Read registers or bits at ADDRESSES (0-15,100) of one Modbus unit. They count from 0: a manual's 30001 is 0.

    WHERE is a serial port (a path), or host or host:port of Modbus TCP.
    """
    from gateway.commissioning.inspection.registers import inspect_registers, modbus_at

    if len(addresses) > _MOST_ADDRESSES:
        raise click.UsageError(f"{len(addresses)} addresses: expected at most {_MOST_ADDRESSES}")
    bus = modbus_at(where, unit, **line)
    sys.exit(0 if inspect_registers(bus, unit, function, addresses, where, draft, form) else EXIT_WORLD)


@click.command("sweep")
@click.argument("where")
@click.option(
    "--unit", type=click.IntRange(*ModbusTcpSettings.units), default=1, show_default=True, help="Modbus unit id."
)
@click.option("--most", type=click.IntRange(1, 65536), default=1000, show_default=True,
              help="Addresses of each table, from 0 on.")  # fmt: skip
@field_option("--baud", ModbusRtuSettings, "baud")
@field_option("--parity", ModbusRtuSettings, "parity")
@click.option("--rtu", is_flag=True, help="RTU frames over TCP, for a device server; give its port.")
@timeout(1.0)
@click.option("--draft", "file", type=AnyFile, help="Write a profile of what is likely meant; a new file.")
@click.option("--quantity", default="degC", show_default=True, help="Unit of the values in the draft.")
def sweep_command(where: str, unit: int, most: int, file: Path | None, quantity: str, **line: Any) -> None:
    """Read all four tables of one Modbus unit at WHERE, mark what changes while you warm a sensor, and draft a profile.

    \b
    One request at a time; reads only. What changed is shown as every number that it may be; the profile has the type,
    the order and the scale with which it is a likely temperature, marked CONFIRM.
    """
    from gateway.commissioning.inspection.registers import modbus_at, sweep_unit

    draft = Draft(file, 1.0, quantity)
    sys.exit(0 if sweep_unit(modbus_at(where, unit, **line), unit, most, where, draft) else EXIT_WORLD)


@click.command("objects")
@click.argument("channel")
@click.argument("node", type=click.IntRange(*CanOpenSettings.units))
@click.argument("objects", type=Written("object", CanObject.of), nargs=-1, required=True)
@field_option("--interface", CanOpenSettings, "interface")
@field_option("--bitrate", CanOpenSettings, "bitrate")
@timeout(1.0)
@field_option("--udp-port", CanOpenSettings, "port", "For udp_multicast only.")
@click.option("--type", "kind", type=click.Choice(BYTE_KINDS), help="Type of all these objects in the draft.")
@with_draft
def objects_command(
    channel: str, node: int, objects: tuple[CanObject, ...], kind: ByteNumber | None, draft: Draft, **place: Any
) -> None:
    """Read OBJECTS (2100:01 6000) of one CANopen NODE by SDO. CHANNEL is can0, or the serial port of an slcan adapter.

    Shows every number that the bytes may be.
    """
    from drivers.canopen.bus import CanOpenBus
    from gateway.commissioning.inspection.named import inspect_objects

    if draft.file is not None and kind is None:
        raise click.UsageError("--draft needs --type: which of the numbers shown are the values?")
    bus = CanOpenBus("inspect", read_settings(CanOpenSettings, {"channel": channel, **place}))
    sys.exit(0 if inspect_objects(bus, node, objects, channel, draft, kind) else EXIT_WORLD)


@click.command("nodes")
@click.argument("url")
@click.argument("nodes", nargs=-1, required=True)
@click.option("--user", help="User name; needs --password-file. Default: anonymous.")
@click.option("--password-file", help="File that contains only the user's password.")
@click.option("--certificate", help="The gateway's certificate; needs --private-key. Without it nothing is encrypted.")
@click.option("--private-key", help="The certificate's key.")
@click.option("--server-certificate", help="The server's certificate; no other is accepted.")
@timeout(5.0)
@click.option("--type", "kind", type=click.Choice(BYTE_KINDS), help="How nodes of bytes hold numbers, for the draft.")
@with_draft
def nodes_command(url: str, nodes: tuple[str, ...], kind: str | None, draft: Draft, **given: Any) -> None:
    """Read NODES ('ns=2;s=/Plc/MW200' i=2258) of the OPC UA server at URL (opc.tcp://host:4840).

    Shows value, type, status and age by the server's own clock; for a node of bytes, such as the process data of an
    IO-Link device, also the numbers that the bytes may be.
    """
    from drivers.opcua.bus import OpcUaBus
    from drivers.opcua.nodes import node_name
    from drivers.opcua.settings import OpcUaBusSettings
    from gateway.commissioning.inspection.named import inspect_nodes

    security = "none" if given["certificate"] is None else "Basic256Sha256"
    known = {name: value for name, value in given.items() if value is not None}
    settings = read_settings(OpcUaBusSettings, {"url": url, "security": security, **known})
    try:
        names = {text: node_name(text) for text in nodes}
    except ValueError as error:
        raise click.UsageError(f"{error}; expected such as 'ns=2;s=/Plc/MW200', i=2258, nsu=urn:maker;s=T1") from error
    bus = OpcUaBus("inspect", settings)
    sys.exit(0 if inspect_nodes(bus, names, url, draft, kind) else EXIT_WORLD)


@click.command("topics")
@click.argument("url")
@click.argument("topics", nargs=-1)
@click.option("--seconds", type=FiniteNumber(min=0.1), default=10.0, show_default=True, help="How long to listen.")
@click.option("--most", type=click.IntRange(1), default=1000, show_default=True,
              help="Stop when this many topics have had a message.")  # fmt: skip
@click.option("--user", help="User name; needs --password-file. Default: anonymous.")
@click.option("--password-file", help="File that contains only the user's password.")
@click.option(
    "--authority", help="Certificates of the authority that issued the broker's. Default: those that the system trusts."
)
@click.option("--certificate", help="This client's certificate; needs --key.")
@click.option("--key", help="The certificate's key.")
@click.option("--client-id", help="Client identifier, if the broker's rules need one.")
@click.option(
    "--allow-unencrypted", is_flag=True, help="Allow mqtt:// beyond this computer, where everyone can read it."
)
@timeout(5.0)
@with_draft
def topics_command(url: str, topics: tuple[str, ...], seconds: float, most: int, draft: Draft, **given: Any) -> None:
    """Listen to TOPICS ('hall/#', 'hall/+/temperature'; all by default) of the MQTT broker at URL (mqtts://host:port).

    Shows each number in the latest payload of each topic, where it is, and how old the payload's own time says it is.
    """
    from drivers.mqtt.bus import MqttBus
    from gateway.commissioning.inspection.topics import inspect_topics

    known = {"url": url} | {name: value for name, value in given.items() if value not in (None, False)}
    bus = MqttBus("inspect", read_settings(MqttBusSettings, known))
    bus.want(topics or ("#",))
    sys.exit(0 if inspect_topics(bus, known, seconds, most, draft) else EXIT_WORLD)
