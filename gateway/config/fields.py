"""Field types that several sections share."""

from pathlib import Path
from typing import Annotated, Final

from pydantic import AfterValidator, ValidationInfo

from drivers.section import beside_the_file, matching

MOST_POSES = 64
LARGEST_BOUND_UM = 1000.0


def _profile_beside_the_file(profile: str, info: ValidationInfo) -> str:
    return str(beside_the_file(Path(profile), info)) if profile.endswith(".toml") else profile


ProfileName = Annotated[str, AfterValidator(_profile_beside_the_file)]
"""A profile's name, or the path of a user's own profile."""

NAME_FORM: Final = r"[A-Za-z][A-Za-z0-9_]{0,63}"
"""The form of the names of machines, buses, devices and channels."""
Name = Annotated[str, matching(NAME_FORM, "a letter, then letters, digits and _, at most 64")]
"""Becomes part of a key, so slash, star, dot and blank are not allowed."""
