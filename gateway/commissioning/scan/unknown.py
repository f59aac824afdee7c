"""Devices that no supplied profile fits: the next command, the mark of their comments, and a user's own profiles."""

import re
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

from drivers.base import SetupError
from drivers.build import BUS_KINDS
from drivers.modbus.settings import ModbusTcpSettings
from drivers.profile import fits_bus
from drivers.profiles import load_profile
from drivers.section import host_and_port
from gateway.commissioning.scan.found import Found, Place
from gateway.model.codes import NoticeCode
from gateway.model.text import Text

_MARK: Final = "# unknown: "
_MODBUS: Final = ("modbus_rtu", "modbus_tcp", "modbus_rtu_tcp")
_OBJECTS: Final = ("1008", "1018:01", "6401:01", "6401:02")
"""Name, vendor and the inputs of CiA 401; the others are in the node's EDS or manual."""


def where_of(place: Place) -> str:
    """The place as `scan` and `inspect` take it: a port, a host, host:port, or a CAN channel."""
    host, port = place.options.get("host"), place.options.get("port")
    if host is None:
        return str(place.options.get("channel", port))
    usual = ModbusTcpSettings.model_fields["port"].default
    return str(host) if port in (None, usual) else host_and_port(str(host), int(str(port)))


def draft_name(place: Place, device: Found) -> str:
    """The file of its profile: devices on two lines may have the same unit."""
    line = re.sub(r"[^0-9A-Za-z]+", "-", where_of(place).rpartition("/")[2])
    return f"{line}-unit{device.unit}.toml"


def next_command(place: Place, device: Found) -> str:
    """What to type to find out what the device sends; empty: no command reads it."""
    where, options = where_of(place), place.options
    draft = ["--draft", draft_name(place, device)]
    if place.kind in _MODBUS:
        line = [f"--{name}={options[name]}" for name in ("baud", "parity") if name in options]
        rtu = ["--rtu"] if place.kind == "modbus_rtu_tcp" else []
        words = ["sweep", where, f"--unit={device.unit}", *line, *rtu, *draft]
    elif place.kind == "canopen":
        at = [f"--{name}={options[name]}" for name in ("interface", "bitrate") if name in options]
        words = ["objects", where, str(device.unit), *_OBJECTS, *at]
    else:
        return ""
    return shlex.join(["talc-gateway", "inspect", *words])


def mark(place: Place, device: Found) -> str:
    """The first line of the comments about the device; the same for the same device at the same place."""
    return f"{_MARK}unit {device.unit} at {place.title}"


def without_marked(text: str, marks: Iterable[str]) -> str:
    """The text without the paragraphs of comments that begin with one of these lines; one that a person has begun to
    uncomment stays."""
    gone = frozenset(marks)
    paragraphs = (paragraph.splitlines() for paragraph in text.split("\n\n"))
    kept = [p for p in paragraphs if not (p and p[0] in gone and all(line.startswith("#") for line in p))]
    return "\n\n".join("\n".join(lines) for lines in kept)


def with_profiles(places: Sequence[Place], profiles: Mapping[str, str]) -> list[Place]:
    """The places with a user's own profile for each unknown device that has one.

    profiles: place and unit of a device, as `key_of` has them, to its profile
    Raises SetupError for a profile that cannot be read, or that is for another kind of bus.
    """
    return [replace(place, devices=tuple(_given(place, device, profiles) for device in place.devices))
            for place in places]  # fmt: skip


def key_of(place: Place, device: Found) -> str:
    """Names a device that was found."""
    return f"{where_of(place)} {device.unit}"


def own_profile(name: str, place: Place) -> int:
    """The number of channels of a user's profile for a device at the place. Raises SetupError."""
    profile = load_profile(name)
    if not fits_bus(profile.buses, place.kind, BUS_KINDS[place.kind].carries):
        raise SetupError(Text(NoticeCode.PROFILE_OF_OTHER_BUS, profile=name, kinds=profile.buses, kind=place.kind))
    return profile.channels


def _given(place: Place, device: Found, profiles: Mapping[str, str]) -> Found:
    name = profiles.get(key_of(place, device))
    if device.what.profile or name is None:
        return device
    path = str(Path(name).absolute())
    inputs = tuple(range(own_profile(path, place)))
    return replace(device, what=replace(device.what, profile=path, inputs=inputs, evidence="your own profile"))
