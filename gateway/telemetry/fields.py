"""Types of fields that published messages and answers to queries share."""

from collections.abc import Sequence
from enum import StrEnum
from typing import Annotated, Any

from msgspec import Meta, Struct

from gateway.model.text import Text, plain, restored, values_of
from talc.kinds import Why


def one_of(texts: type[StrEnum] | tuple[str, ...], description: str = "") -> Meta:
    """A field with one of these texts at present; later versions may add more."""
    known = [str(text) for text in texts]
    return Meta(description=description or None, extra_json_schema={"examples": known})


class Coded(Struct, frozen=True):
    """What a text says, as data: the text beside it is its English sentence."""

    code: Annotated[str, Meta(description="Never means anything else; later versions may add more")]
    values: Annotated[
        dict[str, Any], Meta(description="What the sentence contains, by name; a text within as `code` and `values`")
    ]


def coded(text: str) -> Coded | None:
    """None: only words."""
    code, values = values_of(text)
    return Coded(code, values) if code else None


def text_from(text: str, of: Coded | None) -> Text:
    """A published text with what it says; of an earlier program, only its words."""
    return plain(text) if of is None else restored(text, of.code, of.values)


def texts_from(texts: Sequence[str], of: Sequence[Coded | None]) -> tuple[Text, ...]:
    """The same of several."""
    return tuple(map(text_from, texts, of)) if len(of) == len(texts) else tuple(map(plain, texts))


Number = float | None
ByError = Annotated[dict[str, Number], Meta(description="By thermal error; µm, and µm/m for EA0C, EB0C and EC0C")]
Utc = Annotated[str, Meta(description="UTC, ISO 8601", extra_json_schema={"format": "date-time"})]
GridIndex = Annotated[int, Meta(description="Grid index: UTC seconds // grid step")]
OffsetsUm = Annotated[tuple[float, float, float], Meta(description="X, Y, Z at the tool centre point, µm")]
Reason = Annotated[str, one_of(Why)]
