"""Devices are data: profiles from `drivers/profiles/*.toml`, or a user's own file of the same form."""

import tomllib
from collections.abc import Callable, Mapping
from importlib.resources import files
from pathlib import Path

from drivers.base import SetupError
from drivers.can_dbc import CanDbcProfile, can_dbc_profile
from drivers.canopen_profile import Cia404Profile, cia404_profile
from drivers.displacement_profile import (
    MeEthernetProfile,
    MeRs485Profile,
    me_ethernet_profile,
    me_rs485_profile,
)
from drivers.modbus_profile import ModbusProfile, modbus_profile
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
    if name.endswith(".toml"):
        path = Path(name)
        try:
            text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise SetupError(f"profile {name}: cannot be read: {error}", hint="give the path of a TOML file") from error
        return _parse(path.stem, text, file=name)
    if name not in profile_names():
        raise SetupError(
            f"profile {name!r} does not exist",
            hint=f"there are {', '.join(profile_names())}, or give a path to a .toml file",
        )
    return _parse(name, (_SUPPLIED / f"{name}.toml").read_text(encoding="utf-8"), file=f"{name}.toml")


def _parse(name: str, text: str, *, file: str) -> Profile:
    try:
        table = Table(tomllib.loads(text), file=file)
    except tomllib.TOMLDecodeError as error:
        raise SetupError(f"{file}: is not TOML: {error}") from error
    return _READERS[table.text("protocol", choices=_READERS)](name, table)
