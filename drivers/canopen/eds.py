"""The entries of an EDS file (CiA 306) that channels need: everything else in it may be missing, or wrong."""

import codecs
import re
from collections.abc import Mapping
from pathlib import Path

from drivers.bounded_file import bytes_of
from drivers.canopen.place import CanObject
from drivers.section import OTHER_ENCODING
from drivers.text import Text

_SECTION = re.compile(r"\s*\[([^\]]*)\]")
_VARIABLES = (0x02, 0x07)
"""Object types DOMAIN and VAR, whose entry is the object itself."""
_UNSIGNED8 = 0x05
_LAST_OWN_TYPE = 0x1B
"""Data types beyond are described by an object of their own."""
_MOST_BYTES = 2**23
_UTF_16 = codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE


class EdsFile:
    """The sections of a file. Names and keys are compared without regard to case.

    Raises OSError.
    """

    def __init__(self, path: Path) -> None:
        self._sections: dict[str, dict[str, str]] = {}
        self._twice: set[tuple[str, str]] = set()
        section: dict[str, str] = {}
        name = ""
        for line in _text(bytes_of(path, _MOST_BYTES)).splitlines():
            if (begun := _SECTION.match(line)) is not None:
                name = begun[1].strip().lower()
                section = self._sections.setdefault(name, {})
                continue
            key, equals, rest = line.partition(";")[0].partition("=")
            if not equals:
                continue
            key, value = key.strip().lower(), rest.strip()
            if section.setdefault(key, value) != value:
                self._twice.add((name, key))

    @property
    def is_empty(self) -> bool:
        return not self._sections

    def entry(self, place: CanObject) -> "EdsEntry":
        """Raises ValueError, saying why, if there is no such entry."""
        index = f"{place.index:04x}"
        own = self._sections.get(f"{index}sub{place.subindex:x}")
        whole = self._sections.get(index)
        if own is not None:
            return EdsEntry(self, f"{index}sub{place.subindex:x}", own)
        if whole is None:
            parts = any(name.startswith(f"{index}sub") for name in self._sections)
            raise ValueError(Text("eds_no_object", object=str(place) if parts else index.upper()))
        if (count := _number(whole.get("compactsubobj"))) and place.subindex <= count:
            is_count = place.subindex == 0
            return EdsEntry(self, index, {"datatype": str(_UNSIGNED8), "accesstype": "ro"} if is_count else whole)
        if _number(whole.get("objecttype"), 0x07) not in _VARIABLES:
            raise ValueError(Text("eds_no_object", object=str(place)))
        if place.subindex:
            raise ValueError(Text("eds_one_number", subindex=place.subindex, object=index.upper()))
        return EdsEntry(self, index, whole)

    def is_stated_twice(self, section: str, key: str) -> bool:
        """Whether the key has several values there."""
        return (section, key) in self._twice

    def own_type(self, number: int) -> int | None:
        """The data type that the file's own one of this number stands for; None: it does not say."""
        return _number(self._sections.get(f"{number:x}sub1", {}).get("defaultvalue"))


class EdsEntry:
    """One object, or one sub-index of it."""

    def __init__(self, file: EdsFile, section: str, values: Mapping[str, str]) -> None:
        self._file, self._section, self._values = file, section, values

    @property
    def name(self) -> str:
        return self._values.get("parametername", "without a name")

    @property
    def data_type(self) -> int | None:
        """Its number (CiA 301, table 44); None: the file does not say. Raises ValueError if it says two."""
        if self._file.is_stated_twice(self._section, "datatype"):
            raise ValueError(Text("eds_two_types", object=self._section.upper()))
        kind = _number(self._values.get("datatype"))
        return kind if kind is None or kind <= _LAST_OWN_TYPE else self._file.own_type(kind)

    @property
    def is_readable(self) -> bool:
        """Also where the file does not say."""
        access = self._values.get("accesstype", "").lower()
        return not access or "r" in access or access == "const"


def _text(content: bytes) -> str:
    if content.startswith(_UTF_16):
        return content.decode("utf-16", "replace")
    if content.startswith(codecs.BOM_UTF8):
        return content.decode("utf-8-sig", "replace")
    return content.decode(OTHER_ENCODING, "replace")


def _number(text: str | None, otherwise: int | None = None) -> int | None:
    """Decimal, or hexadecimal with 0x; zeros before it do not make it octal."""
    if not text:
        return otherwise
    try:
        return int(text, 16) if text.lower().startswith("0x") else int(text, 10)
    except ValueError:
        return otherwise
