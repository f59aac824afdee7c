"""Field types that several sections share."""

from pathlib import Path
from typing import Annotated, Final

from pydantic import AfterValidator, ValidationInfo

from drivers.section import beside_the_file, in_form
from gateway.model.codes import NoticeCode

LOOPBACK: Final = "tcp/127.0.0.1:7447"
"""Zenoh endpoint on which a gateway listens, and is looked for, unless somebody says otherwise: this computer alone."""
DEFAULT_PREFIX: Final = "talc"
"""What its keys begin with, unless somebody says otherwise."""
MOST_POSES = 64
LARGEST_BOUND_UM = 1000.0


def _profile_beside_the_file(profile: str, info: ValidationInfo) -> str:
    return str(beside_the_file(Path(profile), info)) if profile.endswith(".toml") else profile


ProfileName = Annotated[str, AfterValidator(_profile_beside_the_file)]
"""A profile's name, or the path of a user's own profile."""

NAME_FORM: Final = r"[A-Za-z][A-Za-z0-9_]{0,63}"
"""The form of the names of machines, buses, devices and channels."""
machine_name: Final = in_form(NAME_FORM, NoticeCode.A_MACHINE_NAME)
"""The text, if it can be one of these names. Raises ValueError."""
Name = Annotated[str, AfterValidator(machine_name)]
"""Becomes part of a key, so slash, star, dot and blank are not allowed."""

key_prefix: Final = in_form(r"[A-Za-z0-9_-]+(/[A-Za-z0-9_-]+)*", NoticeCode.A_KEY_PREFIX)
"""The text, if published keys may begin with it. Raises ValueError."""
KeyPrefix = Annotated[str, AfterValidator(key_prefix)]
"""What all keys of a gateway begin with, before the machine's name: no wildcard, and no part is empty."""
