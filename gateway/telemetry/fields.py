"""Types of fields that published messages and answers to queries share."""

from enum import StrEnum
from typing import Annotated

from msgspec import Meta

from talc.kinds import Why


def one_of(texts: type[StrEnum] | tuple[str, ...], description: str = "") -> Meta:
    """A field with one of these texts at present; later versions may add more."""
    known = [str(text) for text in texts]
    return Meta(description=description or None, extra_json_schema={"examples": known})


Number = float | None
ByError = Annotated[dict[str, Number], Meta(description="By thermal error; µm, and µm/m for EA0C, EB0C and EC0C")]
Utc = Annotated[str, Meta(description="UTC, ISO 8601", extra_json_schema={"format": "date-time"})]
GridIndex = Annotated[int, Meta(description="Grid index: UTC seconds // grid step")]
OffsetsUm = Annotated[tuple[float, float, float], Meta(description="X, Y, Z at the tool centre point, µm")]
Reason = Annotated[str, one_of(Why)]
