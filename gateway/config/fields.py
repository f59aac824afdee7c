"""Field types that several sections share, and how a section behaves: frozen, strict, no unknown keys."""

import re
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationInfo

MOST_POSES = 64
LARGEST_BOUND_UM = 1000.0


class Section(BaseModel):
    """One table of the file. The text under each field is its reference and its error message's neighbour."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True, hide_input_in_errors=True
    )


def _beside_the_file(path: Path, info: ValidationInfo) -> Path:
    """A relative path is meant from the configuration's folder, wherever the gateway was started."""
    folder = info.context.get("folder") if isinstance(info.context, dict) else None
    return path if folder is None or path.is_absolute() else Path(folder) / path


def _profile_beside_the_file(profile: str, info: ValidationInfo) -> str:
    return str(_beside_the_file(Path(profile), info)) if profile.endswith(".toml") else profile


ProfileName = Annotated[str, AfterValidator(_profile_beside_the_file)]
"""A profile's name, or the path of a user's own profile."""
FilePath = Annotated[Path, AfterValidator(_beside_the_file)]


def matching(pattern: str, expected: str) -> AfterValidator:
    """A validator of a text's form whose message is for a person."""
    compiled = re.compile(pattern)

    def check(text: str) -> str:
        if not compiled.fullmatch(text):
            raise ValueError(f"{text!r}: expected {expected}")
        return text

    return AfterValidator(check)


Name = Annotated[str, matching(r"[A-Za-z][A-Za-z0-9_]{0,63}", "a letter, then letters, digits and _, at most 64")]
"""Becomes a part of the key space, so no slash, star, dot or blank."""

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
