"""Profiles of CANopen nodes that follow no device profile known here: which objects are channels."""

from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import ClassVar, Final, Literal, Self

from pydantic import Field, PrivateAttr, model_validator

from drivers.canopen.eds import EdsFile
from drivers.canopen.place import CanObject
from drivers.error_words import in_words
from drivers.faults import NumberRule
from drivers.number_types import ByteNumber, raw_number
from drivers.profile import DeviceProfile, LinearValue
from drivers.section import FilePath, wrong
from drivers.text import Text, text_of

_IN_EDS: Final[Mapping[int, ByteNumber]] = {
    0x01: "bool", 0x02: "int8", 0x03: "int16", 0x04: "int32", 0x05: "uint8", 0x06: "uint16", 0x07: "uint32",
    0x08: "float32", 0x11: "float64", 0x15: "int64", 0x1B: "uint64",
}  # fmt: skip
"""Numbers of the data types in an EDS (CiA 301, table 44)."""


class ObjectEntry(LinearValue):
    """One channel: value = number of the object * scale + offset."""

    index: int = Field(ge=0x1000, le=0xFFFF)
    """Index in the node's object dictionary, such as 0x2100."""
    subindex: int = Field(default=0, ge=0, le=254)
    """Sub-index; 0 of an object that is one number."""
    type: ByteNumber | None = None
    """How the node sends the number; None: as the EDS states it."""
    invalid: tuple[NumberRule, ...] = ()
    """Numbers, as sent, that mean a fault, the most specific first."""

    @property
    def place(self) -> CanObject:
        return CanObject(self.index, self.subindex)


class CanOpenProfile(DeviceProfile):
    """A CANopen node of any kind."""

    buses: ClassVar[tuple[str, ...]] = ("canopen",)

    protocol: Literal["canopen"]
    """`canopen`."""
    eds: FilePath | None = None
    """The node's EDS (or DCF) file; a relative path starts at the profile's folder."""
    vendor_id: int | None = Field(default=None, ge=0, le=0xFFFFFFFF)
    """What object 1018:01 must hold; None: not checked."""
    product_code: int | None = Field(default=None, ge=0, le=0xFFFFFFFF)
    """What object 1018:02 must hold; None: not checked."""
    objects: tuple[ObjectEntry, ...] = Field(alias="object", min_length=1)
    _types: tuple[ByteNumber, ...] = PrivateAttr(default=())

    @model_validator(mode="after")
    def _typed(self) -> Self:
        file = None if self.eds is None else _read(self.eds)
        types = []
        for number, entry in enumerate(self.objects):
            at: tuple[str | int, ...] = ("object", number)
            kind = entry.type if file is None else _in(file, entry, *at)
            if kind is None:
                raise wrong(Text("eds_or_type"), *at, "type")
            for i, rule in enumerate(entry.invalid):
                raw_number(kind, str(entry.place)).check(rule, *at, "invalid", i)
            types.append(kind)
        self._types = tuple(types)
        return self

    @property
    def other_file(self) -> tuple[str, Path] | None:
        """The EDS file."""
        return None if self.eds is None else ("eds", self.eds)

    @property
    def channels(self) -> int:
        """Number of channels."""
        return len(self.objects)

    @cached_property
    def types(self) -> tuple[ByteNumber, ...]:
        """How the node sends each channel's number."""
        return self._types


def _read(path: Path) -> EdsFile:
    try:
        file = EdsFile(path)
    except OSError as error:
        raise wrong(Text("path_unreadable", path=str(path), why=in_words(error)), "eds") from error
    if file.is_empty:
        raise wrong(Text("eds_empty", path=str(path)), "eds")
    return file


def _in(file: EdsFile, entry: ObjectEntry, *at: str | int) -> ByteNumber | None:
    """The type of an object by the EDS; None: it states none, nor does the entry.

    Raises an error if it is not there, not readable, or of another type.
    """
    try:
        found = file.entry(entry.place)
        data_type = found.data_type
    except ValueError as error:
        raise wrong(text_of(error), *at, "index" if entry.subindex == 0 else "subindex") from error
    if not found.is_readable:
        raise wrong(Text("eds_not_readable", object=str(entry.place), name=found.name), *at, "index")
    if data_type is None:
        return entry.type
    kind = _IN_EDS.get(data_type)
    if kind is None:
        raise wrong(Text("eds_no_number", object=str(entry.place), name=found.name), *at, "index")
    if entry.type not in (None, kind):
        raise wrong(
            Text("eds_other_type", type=entry.type, object=str(entry.place), name=found.name, stated=kind), *at, "type"
        )
    return kind
