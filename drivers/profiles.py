"""Loads device profiles, from `drivers/profiles/*.toml` or from a user's own file of the same form."""

from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import sha256
from importlib.resources import files
from pathlib import Path

from drivers.base import SetupError
from drivers.bounded_file import bytes_of
from drivers.error_words import in_words
from drivers.families import DEVICES
from drivers.problems import read_settings, suggestion
from drivers.profile import DeviceProfile
from drivers.section import OTHER_ENCODING
from drivers.text import Text, shown, text_of
from drivers.toml_text import TomlError, nearest, toml_data, toml_lines, utf8_text

_MOST_OTHER_BYTES = 2**23
"""Of the file that a profile refers to."""
_SUPPLIED = files("drivers") / "profiles"


def profile_names() -> tuple[str, ...]:
    """Names of the profiles that are supplied with the drivers."""
    return tuple(sorted(Path(entry.name).stem for entry in _SUPPLIED.iterdir() if entry.name.endswith(".toml")))


def load_profile(name: str) -> DeviceProfile:
    """The profile with that name, or from that file when `name` ends with `.toml`.

    Raises SetupError naming file, field and value, or listing the profiles that exist.
    """
    if is_users(name):
        return _parse(Path(name).stem, _decoded(name, _bytes(name)), file=name)
    if name not in profile_names():
        raise SetupError(
            Text("profile_unknown", profile=name),
            hint=Text("profiles_known", names=profile_names()),
        )
    return _parse(name, (_SUPPLIED / f"{name}.toml").read_text(encoding="utf-8"), file=f"{name}.toml")


def is_users(name: str) -> bool:
    """Whether this names a user's own file, not a supplied profile."""
    return name.endswith(".toml")


@dataclass(frozen=True, slots=True)
class UserProfile:
    """A user's own profile as read from its files at one moment."""

    profile: DeviceProfile
    text: str
    other: tuple[str, str] | None
    """Key and text of the file that it refers to, if any."""
    content_hash: str
    """SHA-256 of the files' bytes, in hexadecimal."""


def user_profile(name: str) -> UserProfile:
    """The current content of a user's profile file and of the file that it refers to. Raises SetupError."""
    own = _bytes(name)
    text = _decoded(name, own)
    profile = _parse(Path(name).stem, text, file=name)
    parts, other = [own], None
    if profile.other_file is not None:
        key, path = profile.other_file
        try:
            parts.append(content := bytes_of(path, _MOST_OTHER_BYTES))
            other = key, _one_line_end(content.decode(OTHER_ENCODING, "replace"))
        except OSError as error:
            raise SetupError(
                Text("in_file", file=name, what=Text("path_unreadable", path=str(path), why=in_words(error)))
            ) from error
    return UserProfile(profile, text, other, sha256(b"".join(sha256(part).digest() for part in parts)).hexdigest())


def _one_line_end(text: str) -> str:
    """The text with the line ends that every reader of these files understands."""
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _bytes(name: str) -> bytes:
    try:
        return bytes_of(Path(name))
    except OSError as error:
        raise SetupError(
            Text("profile_unreadable", profile=name, why=in_words(error)), hint=Text("profile_give_toml")
        ) from error


def _decoded(name: str, content: bytes) -> str:
    try:
        return utf8_text(content)
    except TomlError as error:
        raise SetupError(Text("in_file", file=f"{name}:{error.line}", what=text_of(error))) from error


def _parse(name: str, text: str, *, file: str) -> DeviceProfile:
    try:
        data = toml_data(text)
    except ValueError as error:
        raise SetupError(Text("profile_not_toml", file=file, error=text_of(error))) from error

    def line_of(location: Sequence[str | int]) -> int:
        """That of the table, if the field is missing."""
        lines = toml_lines(text)
        return lines.get(nearest(tuple(location), lines), 0)

    protocol = data.get("protocol", "")
    if not isinstance(protocol, str) or protocol not in DEVICES:
        possible = suggestion(str(protocol), DEVICES)
        what = (
            Text("invalid", value=shown(protocol), advice=possible)
            if protocol
            else Text("missing_one", advice=possible)
        )
        at = f"{file}:{line}" if (line := line_of(("protocol",))) else file
        raise SetupError(Text("in_file", file=at, what=Text("at_field", field="protocol", what=what)))
    kind: type[DeviceProfile] = DEVICES[protocol].profile
    return read_settings(kind, data, {"name": name, "folder": Path(file).parent}, file=file, line_of=line_of)
