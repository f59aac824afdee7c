"""Loads device profiles: from `drivers/profiles/*.toml`, or from a user's own file of the same form."""

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from hashlib import sha256
from importlib.resources import files
from pathlib import Path

from drivers.base import SetupError
from drivers.can.dbc import DBC_ENCODING, CanDbcProfile, can_dbc_profile, dbc_path
from drivers.canopen.profile import Cia404Profile, cia404_profile
from drivers.micro_epsilon.profile import (
    MeEthernetProfile,
    MeRs485Profile,
    me_ethernet_profile,
    me_rs485_profile,
)
from drivers.modbus.profile import ModbusProfile, modbus_profile
from drivers.toml_table import Table

Profile = ModbusProfile | Cia404Profile | CanDbcProfile | MeRs485Profile | MeEthernetProfile

_READERS: Mapping[str, Callable[[str, Table], Profile]] = {
    "modbus": modbus_profile,
    "cia404": cia404_profile,
    "can_dbc": can_dbc_profile,
    "me_rs485": me_rs485_profile,
    "me_ethernet": me_ethernet_profile,
}
_SUPPLIED = files("drivers") / "profiles"


def profile_names() -> tuple[str, ...]:
    """Names of the profiles that come with the drivers."""
    return tuple(sorted(Path(entry.name).stem for entry in _SUPPLIED.iterdir() if entry.name.endswith(".toml")))


def load_profile(name: str) -> Profile:
    """The profile of that name, or from that file when `name` ends with `.toml`.

    Raises SetupError naming file, field and value, or listing the profiles that exist.
    """
    if is_users(name):
        return _parse(Path(name).stem, _users_table(name))
    if name not in profile_names():
        raise SetupError(
            f"profile {name!r} does not exist",
            hint=f"there are {', '.join(profile_names())}, or give a path to a .toml file",
        )
    return _parse(name, _table((_SUPPLIED / f"{name}.toml").read_text(encoding="utf-8"), file=f"{name}.toml"))


def is_users(name: str) -> bool:
    """Whether that names a file of the user's own, not a supplied profile."""
    return name.endswith(".toml")


@dataclass(frozen=True, slots=True)
class UserProfile:
    """A user's own profile as its files held it at one moment."""

    text: str
    dbc: str | None
    """Of the DBC file that it names, if it does."""
    content_hash: str
    """SHA-256 of the files' bytes, in hexadecimal."""


def user_profile(name: str) -> UserProfile:
    """What the user's profile in that file holds now, with the DBC file that it names. Raises SetupError."""
    path, table = Path(name), _users_table(name)
    try:
        own = path.read_bytes()
        named = dbc_path(table).read_bytes() if table.text("protocol", choices=_READERS) == "can_dbc" else None
        text = _one_line_end(own.decode("utf-8"))
        dbc = None if named is None else _one_line_end(named.decode(DBC_ENCODING))
    except (OSError, UnicodeDecodeError) as error:
        raise SetupError(f"profile {name}: cannot be read: {error}") from error
    parts = [own] if named is None else [own, named]
    return UserProfile(text, dbc, sha256(b"".join(sha256(part).digest() for part in parts)).hexdigest())


def _one_line_end(text: str) -> str:
    """As every reader of these files takes it."""
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _users_table(name: str) -> Table:
    try:
        text = Path(name).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise SetupError(f"profile {name}: cannot be read: {error}", hint="give the path of a TOML file") from error
    return _table(text, file=name)


def _table(text: str, *, file: str) -> Table:
    try:
        return Table(tomllib.loads(text), file=file)
    except tomllib.TOMLDecodeError as error:
        raise SetupError(f"{file}: is not TOML: {error}") from error


def _parse(name: str, table: Table) -> Profile:
    return _READERS[table.text("protocol", choices=_READERS)](name, table)
