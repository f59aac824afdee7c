"""Drafts of profiles for CANopen objects, OPC UA nodes and MQTT topics that were read by hand."""

from collections.abc import Mapping, Sequence

from drivers.canopen.place import CanObject
from drivers.number_types import ByteNumber
from gateway.commissioning.scan.fragment import CONFIRM
from gateway.config.wires import toml_value

BYTE_KINDS: tuple[ByteNumber, ...] = (
    "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64",
)  # fmt: skip
"""What bytes are shown as; a truth value would be shown twice."""


def object_draft(seen: Mapping[CanObject, str], *, kind: str, scale: float, unit: str, place: str, when: str) -> str:
    """A profile of these objects, all of one type; `seen`: the value that each had, as text."""
    scaling = [] if scale == 1 else [f"scale = {scale!r}"]
    blocks = [
        [
            "[[object]]",
            f"# seen: {text}",
            f"index = 0x{found.index:04X}",
            f"subindex = {found.subindex}",
            f"type = {toml_value(kind)}",
            *scaling,
        ]
        for found, text in seen.items()
    ]
    return draft_text("canopen", "type, scale and unit", unit, blocks, place, when)


def node_draft(
    seen: Mapping[str, object], *, scale: float, unit: str, place: str, when: str, kind: str | None = None
) -> str:
    """A profile of these nodes of an OPC UA server.

    seen: what each held, a number or bytes
    kind: how bytes hold the number, from the first one on
    """
    scaling = [] if scale == 1 else [f"scale = {scale!r}"]
    blocks = []
    for name, value in seen.items():
        held = value.hex(" ") if isinstance(value, bytes) else repr(value)
        of_bytes = ["element = 0", f"type = {toml_value(kind)}"] if isinstance(value, bytes) else []
        blocks.append(["[[node]]", f"# seen: {held}", f"node = {toml_value(name)}", *of_bytes, *scaling])
    return draft_text("opcua", "scale and unit", unit, blocks, place, when)


def draft_text(
    protocol: str,
    chosen: str,
    unit: str,
    blocks: Sequence[Sequence[str]],
    place: str,
    when: str,
    more: Sequence[str] = (),
) -> str:
    """A profile: its head, with `more` lines, and a section for each block of lines. chosen: what must be confirmed."""
    head = [
        f"# Draft by `talc-gateway inspect`: what {place} answered at {when}.",
        f"# {CONFIRM}: the device does not state {chosen}; compare the values.",
        f"protocol = {toml_value(protocol)}",
        f"title = {toml_value(place)}  # {CONFIRM}: which device this is",
        f"unit = {toml_value(unit)}",
        *more,
    ]
    return "\n\n".join("\n".join(lines) for lines in (head, *blocks)) + "\n"
