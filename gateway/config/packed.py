"""Packs the wires of a configuration with the user's own profiles, so that a recording can be played elsewhere.

It is the TOML of `wires_toml`, plus a table `[files]` with the text of each file by name. Profiles refer to these.
"""

import re
import tomllib
from collections.abc import Mapping
from pathlib import Path

from drivers.profiles import UserProfile
from drivers.section import OTHER_ENCODING
from gateway.config.file import from_data
from gateway.config.model import GatewayConfig
from gateway.config.problems import ConfigError, Problem, shown
from gateway.config.reading import data_of
from gateway.config.wires import toml_value, wires_toml
from gateway.model.codes import NoticeCode
from gateway.model.text import Text

_FILES = "files"
_FOLDER = "profiles"
_ENCODINGS = {".toml": "utf-8", ".dbc": OTHER_ENCODING, ".eds": OTHER_ENCODING}


def packed_toml(config: GatewayConfig) -> str:
    """The wires, and the profiles as they were when the configuration was loaded."""
    names: dict[str, str] = {}
    files: dict[str, str] = {}
    for path, profile in config.profiles.items():
        stem, count = Path(path).stem, 1
        while (name := stem if count == 1 else f"{stem}_{count}") + ".toml" in files:
            count += 1
        names[path] = f"{name}.toml"
        files |= _files(name, profile)
    text = wires_toml(config, profiles=names)
    if files:
        text += f"\n[{_FILES}]\n" + "".join(f"{toml_value(name)} = {_toml_text(files[name])}\n" for name in files)
    return text


def unpacked(text: str, path: Path, folder: Path) -> GatewayConfig:
    """The checked configuration from the text of `packed_toml`; its files are written into `folder`/profiles.

    path: name in messages, and where other relative paths start

    Raises ConfigError, or OSError when the files cannot be written.
    """
    data = data_of(text, path)
    contents = {name: _content(name, value, path) for name, value in _table(data.pop(_FILES, {}), path).items()}
    folder = folder.resolve() / _FOLDER
    if contents:
        folder.mkdir(parents=True, exist_ok=True)
    for name, content in contents.items():
        (folder / name).write_bytes(content)
    devices = data.get("device")
    for device in devices if isinstance(devices, list) else ():
        if isinstance(device, dict) and device.get("profile") in contents:
            device["profile"] = str(folder / device["profile"])
    return from_data(data, path)


def _files(name: str, profile: UserProfile) -> dict[str, str]:
    """The profile, with the file that it refers to in the same folder wherever it was."""
    if profile.other is None:
        return {f"{name}.toml": profile.text}
    key, text = profile.other
    file = f"{name}.{key}"
    return {f"{name}.toml": _naming(profile.text, key, file), file: text}


def _naming(text: str, key: str, file: str) -> str:
    """The profile's text with another file for the key; a similar key inside a longer text stays."""
    wanted = tomllib.loads(text) | {key: file}
    for found in re.finditer(rf"""(?m)^[ \t]*["']?{key}["']?[ \t]*=.*$""", text):
        changed = f"{text[: found.start()]}{key} = {toml_value(file)}{text[found.end() :]}"
        try:
            if tomllib.loads(changed) == wanted:
                return changed
        except tomllib.TOMLDecodeError:
            continue
    return text


def _toml_text(text: str) -> str:
    """As separate lines where TOML can express it."""
    lines = f"'''\n{text}'''"
    try:
        if tomllib.loads(f"text = {lines}") == {"text": text}:
            return lines
    except tomllib.TOMLDecodeError:
        pass
    return toml_value(text)


def _table(files: object, path: Path) -> Mapping[str, object]:
    if not isinstance(files, dict):
        raise ConfigError(path, [Problem(_FILES, Text("expected", value=shown(files), wanted=Text("a_table")))])
    return files


def _content(name: str, text: object, path: Path) -> bytes:
    """The bytes of one file. A recording is from elsewhere, so its files must stay in their folder."""
    where = f"[{_FILES}] {name}"
    encoding = _ENCODINGS.get(Path(name).suffix)
    if encoding is None or Path(name).name != name:
        raise ConfigError(path, [Problem(where, Text(NoticeCode.PACKED_NAME))])
    if not isinstance(text, str):
        raise ConfigError(path, [Problem(where, Text("expected", value=shown(text), wanted=Text("a_text")))])
    try:
        return text.encode(encoding)
    except UnicodeEncodeError as error:
        raise ConfigError(
            path,
            [Problem(where, Text(NoticeCode.PACKED_ENCODING, letter=error.object[error.start], encoding=encoding))],
        ) from None
