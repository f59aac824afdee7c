"""Makes valid configuration text from a scan's result: `[[bus]]` and `[[device]]` sections."""

import re
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import count
from pathlib import Path

from drivers.build import BUS_KINDS
from drivers.problems import settings_of
from drivers.profiles import load_profile
from gateway.commissioning.scan.found import Found, Place
from gateway.commissioning.scan.unknown import draft_name, key_of, mark, next_command, without_marked
from gateway.config.file import draft, parse
from gateway.config.model import GatewayConfig
from gateway.config.polled import BusSection
from gateway.config.wires import toml_value

CONFIRM = "CONFIRM"
"""Marks a comment beside a guess, which a person must put right."""
_UNIT_NAMES = {"degC": "rtd", "µm": "growth"}


def check_addable(existing: str, path: Path) -> None:
    """Raises ConfigError if nothing could be added to `existing`, whatever is found. Called before a scan."""
    if existing.strip():
        _check(existing, path)


def _check(text: str, path: Path) -> None:
    """Raises ConfigError. Without devices a configuration is not valid, but may become so."""
    if draft(text, path).devices:
        parse(text, path)


def merged(existing: str, places: Sequence[Place], path: Path) -> str:
    """`existing` (which may be empty) with a section for every recognised device that it does not have yet, and
    comments, with the next command, for every unknown one.

    Every name is new, so several scans can go into one file. `path` names the file in messages. The text is checked
    before it is returned: raises ConfigError with every problem, including those of `existing`.
    """
    before = existing.rstrip("\n") if existing.strip() else '[machine]\nname = "machine"'
    config = draft(before, path)
    names = _Names(config)
    groups = list(_by_port([_absolute(place) for place in places]))
    before = without_marked(before, _outdated(groups, config))
    said = frozenset(before.splitlines())
    parts = [before]
    for group in groups:
        parts += _sections(group, config, names, said, path.resolve().parent)
    text = "\n\n".join(parts) + "\n"
    _check(text, path)
    return text


def unknown_devices(existing: str, places: Iterable[Place], path: Path) -> list[tuple[Place, Found]]:
    """Each once per wire: what neither a profile describes nor `existing` has, and where. Raises ConfigError."""
    config = draft(existing or '[machine]\nname = "machine"', path)
    found = (
        (place, device)
        for place in places
        for device in place.devices
        if not device.what.profile and not _has(config, _existing_bus(config, _absolute(place)), device)
    )
    return list({key_of(place, device): (place, device) for place, device in found}.values())


def _outdated(groups: Iterable[Sequence[Place]], config: GatewayConfig) -> Iterator[str]:
    """Marks of comments on a wire of which more is known now."""
    for group in groups:
        known = _existing_bus(config, group[0])
        if any(device.what.profile and not _has(config, known, device) for device in group[0].devices):
            yield from (mark(place, device) for place in group for device in place.devices)


class _Names:
    """Names of buses, devices and channels that are free."""

    def __init__(self, config: GatewayConfig) -> None:
        self._used = set(re.findall(r"\w+", config.canonical()))

    def free(self, stem: str) -> str:
        name = next(name for i in count(1) if (name := f"{stem}{i}") not in self._used)
        self._used.add(name)
        return name


def _by_port(places: Sequence[Place]) -> Iterator[list[Place]]:
    """Places that share a wire, the one with most recognised devices first: a bus has one speed and one protocol."""
    wires: dict[str, list[Place]] = {}
    for place in places:
        wires.setdefault(_wire(place), []).append(place)
    for group in wires.values():
        yield sorted(group, key=lambda place: -sum(bool(device.what.profile) for device in place.devices))


def _wire(place: Place) -> str:
    options = place.options
    return str(options.get("host") or options.get("channel")) + f" {options.get('port', '')}"


def _serial_port(place: Place) -> str | None:
    """The option that is a path: in a scan it starts at the working directory, in a file at the file's folder."""
    there = settings_of(BUS_KINDS[place.kind], place.options).serial_path
    return None if there is None else there[0]


def _absolute(place: Place) -> Place:
    key = _serial_port(place)
    if key is None or "://" in str(place.options[key]):  # the URL of a device server's port
        return place
    return replace(place, options={**place.options, key: str(Path.cwd() / str(place.options[key]))})


def _options(place: Place, folder: Path) -> Iterator[tuple[str, object]]:
    """The options as a file in this folder has them."""
    port = _serial_port(place)
    for key, value in place.options.items():
        beside = key == port and Path(str(value)).parent == folder
        yield key, Path(str(value)).name if beside else value


def _sections(
    group: list[Place], config: GatewayConfig, names: _Names, said: Collection[str], folder: Path
) -> list[str]:
    """The sections of one wire; devices that do not fit on the same bus become comments, unless `said` has them."""
    known = _existing_bus(config, group[0])
    first = next((place for place in group if known is None or _fits(known, place)), Place(group[0].kind, {}))
    as_what = "the others" if known is None else f"bus {known.name}, which is {_as_place(known, group[0]).title}"
    lines = _comments(
        f"{device.what.profile or 'a unit'} at unit {device.unit} answers as {other.title}: set it as {as_what}"
        for other in group if other is not first for device in other.devices
    )  # fmt: skip
    new = [device for device in first.devices if not _has(config, known, device)]
    usable = [device for device in new if device.what.profile]
    unknown = [device for device in new if not device.what.profile and mark(first, device) not in said]
    lines = [line for line in lines if line not in said]
    bus, its_lines = known.name if known is not None else "", list[str]()
    if known is None and (usable or unknown):
        bus = names.free(BUS_KINDS[first.kind].name_stem)
        its_lines = ["[[bus]]", f"name = {toml_value(bus)}", f"kind = {toml_value(first.kind)}"]
        its_lines += [f"{key} = {toml_value(value)}" for key, value in _options(first, folder)]
    if usable:
        lines, its_lines = [*lines, *its_lines], []
    sections = ["\n".join(lines)] if lines else []
    addressed = BUS_KINDS[first.kind].units is not None
    sections += [_device(bus, device, names, addressed, folder) for device in usable]
    for device in unknown:
        sections.append(_unknown(first, device, its_lines, bus, names))
        its_lines = []
    return sections


def _existing_bus(config: GatewayConfig, place: Place) -> BusSection | None:
    """The bus on the same wire, whatever its protocol and speed."""
    where = {key: value for key, value in place.options.items() if key in ("port", "host", "channel")}
    return next((bus for bus in config.buses if _as_place(bus, place).options.items() >= where.items()), None)


def _fits(bus: BusSection, place: Place) -> bool:
    """Whether the devices at the place would also answer on the bus."""
    there = dict(_as_place(bus, place).options)
    if there.get("interface") == "socketcan":  # the system sets the bit rate, not the file
        there["bitrate"] = place.options["bitrate"]
    return bus.kind == place.kind and there == dict(place.options)


def _as_place(bus: BusSection, place: Place) -> Place:
    """The bus, from the fields that a scan knows of the place."""
    options = bus.model_dump()
    return Place(bus.kind, {key: options[key] for key in place.options if key in options})


def _has(config: GatewayConfig, known: BusSection | None, device: Found) -> bool:
    """Whether the file has the device. A bus without addresses is one device."""
    if known is None:
        return False
    return any(known.units is None or d.unit == device.unit for d in config.devices_of(known.name))


def _unknown(place: Place, device: Found, bus_lines: Sequence[str], bus: str, names: _Names) -> str:
    """Sections that become valid when they are uncommented and the profile is there."""
    name = names.free("device")
    lines = [device.what.evidence]
    if command := next_command(place, device):
        lines += [f"next: {command}"]
    lines += [f"then `talc-gateway init` again with that profile, or uncomment. {CONFIRM}: which device this is"]
    lines += [
        *bus_lines,
        "[[device]]",
        f"name = {toml_value(name)}",
        f"bus = {toml_value(bus)}",
        f'profile = "{draft_name(place, device)}"',
        f"unit = {device.unit}",
        "[device.channels]",
        f"{name}_in0 = 0",
    ]
    return "\n".join([mark(place, device), *_comments(lines)])


def _device(bus: str, device: Found, names: _Names, addressed: bool, folder: Path) -> str:
    what = device.what
    profile = load_profile(what.profile)
    own = Path(what.profile)
    written = own.name if own.parent == folder else what.profile
    name = names.free(_UNIT_NAMES.get(profile.unit, "device"))
    lines = _comments([f"{profile.title}; {what.evidence}", *(f"{CONFIRM}: {doubt}" for doubt in what.doubts)])
    if device.reads:
        lines += _comments([f"when found: {device.reads}"])
    lines += [
        "[[device]]",
        f"name = {toml_value(name)}",
        f"bus = {toml_value(bus)}",
        f"profile = {toml_value(written)}",
    ]
    if addressed:
        lines += [f"unit = {device.unit}"]
    if what.options:
        lines += ["[device.options]", *(f"{key} = {toml_value(value)}" for key, value in what.options.items())]
    lines += [
        f"[device.channels]  # {CONFIRM}: a name for each input, such as bed_front_left",
        *(f"{name}_in{number} = {number}" for number in what.inputs),
    ]
    return "\n".join(lines)


def _comments(texts: Iterable[str]) -> list[str]:
    """One comment line each, whatever characters a device's name contains."""
    return ["# " + "".join(c if c.isprintable() else " " for c in text) for text in texts]
