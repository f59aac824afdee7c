"""Gives channels other names in the text of a configuration, and leaves everything else as it is."""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

from drivers.toml_text import Location, toml_data, toml_lines
from gateway.commissioning.scan.fragment import CONFIRM
from gateway.config.file import parse
from gateway.config.problems import ConfigError, Problem
from gateway.model.codes import NoticeCode
from gateway.model.text import Text

_PLACES: Final = (("device", int, "channels"), ("limits",), ("planned_load", int, "loads"))
"""The tables whose keys are channels."""
_ASKED: Final = re.compile(rf"[ \t]*# {CONFIRM}: a name for each input[^\r\n]*")
"""What a scan writes beside `[device.channels]`."""


def renamed(text: str, names: Mapping[str, str], path: Path) -> str:
    """The text with these channels (old name to new) under their new names, wherever it names them; two may exchange
    theirs. `path` names the file in messages.

    Raises ConfigError if the configuration is not valid then, or is written in a way that this does not understand.
    """
    data, lines = toml_data(text), text.split("\n")
    wanted = _data(data, (), names)
    found: dict[int, dict[str, str]] = {}
    for location, number in toml_lines(text).items():
        if _is_channel(location) and (name := str(location[-1])) in names:
            found.setdefault(number - 1, {})[name] = names[name]
    for index, theirs in found.items():
        lines[index] = _line(lines[index], theirs)
    made = "\n".join(lines)
    try:
        same = list(_pairs(toml_data(made))) == list(_pairs(wanted))
    except ValueError:
        same = False
    if not same:
        channels = ", ".join(f"{old} = {new}" for old, new in names.items())
        raise ConfigError(path, [Problem("", Text(NoticeCode.NAMES_NOT_WRITTEN, names=channels))])
    parse(made, path)
    return made


def confirmed(text: str, device: str) -> str:
    """The text without the scan's request to name the channels of this device."""
    lines, numbers, data = text.split("\n"), toml_lines(text), toml_data(text)
    devices = data.get("device")
    for index, each in enumerate(devices if isinstance(devices, list) else ()):
        number = numbers.get(("device", index, "channels"))
        if number is not None and isinstance(each, dict) and each.get("name") == device:
            lines[number - 1] = _ASKED.sub("", lines[number - 1])
    return "\n".join(lines)


def _is_channel(location: Location) -> bool:
    return tuple(int if isinstance(part, int) else part for part in location[:-1]) in _PLACES


def _line(line: str, names: Mapping[str, str]) -> str:
    """With the keys replaced, and not what is in values and comments."""
    keys = "|".join(map(re.escape, names))
    key = re.compile(rf"""(?<![\w-])(["']?)({keys})\1(?=\s*[=\].])""")
    return key.sub(lambda found: names[found[2]], line)


def _data(value: object, at: Location, names: Mapping[str, str]) -> object:
    """The data as they shall be."""
    if isinstance(value, Mapping):
        return {
            names.get(key, key) if _is_channel((*at, key)) else key: _data(inner, (*at, key), names)
            for key, inner in value.items()
        }
    if isinstance(value, list):
        return [_data(inner, (*at, index), names) for index, inner in enumerate(value)]
    return value


def _pairs(value: object, at: Location = ()) -> Iterator[tuple[Location, object]]:
    """In their order, which is that of the inputs."""
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _pairs(inner, (*at, key))
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            yield from _pairs(inner, (*at, index))
    else:
        yield at, value
