"""Reads TOML files, those of a gateway and others. Loads no model of a configuration."""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, TypeVar, Union

from pydantic import BaseModel, Field

from drivers.bounded_file import bytes_of
from drivers.toml_text import TomlError, toml_data, utf8_text
from gateway.config.problems import ConfigError, Problem, located, place, read_sections, spot_of
from gateway.model.codes import NoticeCode
from gateway.model.text import Text, text_of
from talc.presets import completed

M = TypeVar("M", bound=BaseModel)


def read_text(path: Path) -> str:
    """The text of a file. Raises ConfigError."""
    try:
        content = bytes_of(path)
    except OSError as error:
        why = error.strerror or str(error)
        raise ConfigError(path, [Problem("", Text(NoticeCode.FILE_NOT_READ, error=why))]) from None
    try:
        return utf8_text(content)
    except TomlError as error:
        spot = spot_of(content.decode("latin-1"), error.line)
        raise ConfigError(path, [Problem("", text_of(error), at=spot)]) from None


def read_as(kind: type[M], path: Path) -> M:
    """What a TOML file of another kind than a configuration holds. Raises ConfigError with every problem found."""
    text = read_text(path)
    with located(text):
        return read_sections(kind, data_of(text, path), path)


def read_data(path: Path) -> dict[str, object]:
    """The data of a file, as `data_of`. Raises ConfigError."""
    return data_of(read_text(path), path)


def data_of(text: str, path: Path) -> dict[str, object]:
    """The data of the text, with those of the `[talc]` preset added; not checked yet. Raises ConfigError."""
    try:
        data = toml_data(text)
    except TomlError as error:
        spot = spot_of(text, error.line)
        raise ConfigError(path, [Problem("", Text(NoticeCode.FILE_NOT_TOML, error=text_of(error)), at=spot)]) from None
    talc = data.get("talc")
    return {**data, "talc": completed(talc)} if isinstance(talc, dict) else data


def kinds_in(data: Mapping[str, object], section: str) -> Iterator[tuple[str, str]]:
    """Each `kind` in the tables `[[section]]` of data that are not checked yet, and its place."""
    tables = data.get(section)
    for index, table in enumerate(tables if isinstance(tables, list) else ()):
        if isinstance(table, Mapping) and isinstance(kind := table.get("kind"), str):
            yield kind, place((section, index, "kind"), data)


def any_section_of(sections: Iterable[type[Any]]) -> Any:
    """The type of whichever of these classes has the `kind` that is given."""
    union: Any = Union  # made of values, which a type checker does not follow
    return Annotated[union[tuple(sections)], Field(discriminator="kind")]
