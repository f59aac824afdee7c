"""Problems of a configuration, one per line, with the file's name and the place as the file names it."""

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Final, TypeVar

from pydantic import BaseModel, ValidationError

from drivers.base import dotted
from drivers.problems import Location, Problem, Spot, problems_of, suggestion
from drivers.section import strictly
from drivers.text import shown
from drivers.toml_text import TomlError, nearest, toml_data, toml_lines
from gateway.model.codes import NoticeCode
from gateway.model.given import GivenError
from gateway.model.text import Text

__all__ = ["ConfigError", "Problem", "place", "read_sections", "shown", "suggestion"]

M = TypeVar("M", bound=BaseModel)

_MOST_SAID = 10
_LONGEST_SHOWN = 300


class ConfigError(GivenError):
    """The configuration cannot be used. The text has one line per problem, each beginning with the file's name, and
    below it, if it is known, the line of the file."""

    def __init__(self, file: Path, problems: Sequence[Problem]) -> None:
        self.file, self.problems = file, tuple(problems)
        super().__init__("\n".join(f"{file}: {problem}{_source(problem.at)}" for problem in self.problems))

    def in_language(self, language: str) -> str:
        """The same lines."""
        return "\n".join(f"{self.file}: {p.in_language(language)}{_source(p.at)}" for p in self.problems)

    @property
    def text(self) -> Text:
        """The first of the problems, with the file's name."""
        found = [Text(NoticeCode.FILE_PROBLEM, file=str(self.file), problem=p.text) for p in self.problems[:_MOST_SAID]]
        return found[0] if len(found) == 1 else Text(NoticeCode.PROBLEMS, problems=found)


def _source(spot: Spot | None) -> str:
    if spot is None:
        return ""
    shown_line = "".join(c if c.isprintable() else " " for c in spot.source.rstrip()[:_LONGEST_SHOWN])
    return f"\n{spot.line:>7} | {shown_line}"


def spot_of(text: str, line: int) -> Spot | None:
    """A line of a text; None if the number is of none."""
    lines = text.split("\n")
    return Spot(line, lines[line - 1]) if 0 < line <= len(lines) else None


@contextmanager
def located(text: str) -> Iterator[None]:
    """A ConfigError from within also says where its problems are in this text."""
    try:
        yield
    except ConfigError as error:
        with suppress(TomlError):
            raise ConfigError(error.file, list(_in_text(error.problems, text))) from None
        raise


def _in_text(problems: Sequence[Problem], text: str) -> Iterator[Problem]:
    """Raises TomlError."""
    data, lines, source = toml_data(text), toml_lines(text), text.split("\n")
    places = {place(location, data): location for location in lines}  # of two with one name the second
    for problem in problems:
        said = problem.where.replace("], ", "] ")
        meant = problem.what.value_of("other") if isinstance(problem.what, Text) else None
        misspelt = None if meant is None else places.get(_LAST_NAME.sub(str(meant), said))
        known = misspelt or _nearest(said, places)
        where = said
        if problem.within and known:
            inner = (*known, *problem.within)
            where, known = place(inner, data), nearest(inner, lines)
            problem = replace(problem, where=where, within=())
        parts = _PLACE.fullmatch(where)
        if problem.at is not None or not known or parts is None:
            yield problem
            continue
        value = _value(known, data) if place(known, data) == where else None
        line = lines[known]
        yield replace(problem, at=Spot(line, source[line - 1], parts[1], parts[2] or "", value))


_PLACE: Final = re.compile(r"(\[[^\]]*\]|\w+ (?:'[^']*'|number \d+))(?:,? (.+))?")
_LAST_NAME: Final = re.compile(r"\w+(?=\]?$)")
_LAST: Final = re.compile(r"[\[., ]*[^\[\]., ]*\]?$")


def _nearest(where: str, places: Mapping[str, tuple[str | int, ...]]) -> tuple[str | int, ...]:
    """The place itself or, if it is not in the file, the section in which it would be; empty: nor is that."""
    while where:
        for form in (where, f"{where}]"):
            if form in places:
                return places[form]
        where = _LAST.sub("", where, count=1)
    return ()


def _value(location: Location, data: object) -> object:
    for part in location:
        data = data[part]  # type: ignore[index]
    return data


def read_sections(kind: type[M], data: Mapping[str, object], path: Path) -> M:
    """The sections that TOML's data describe; relative paths start at the file's folder.

    Raises ConfigError with every problem found.
    """
    try:
        return strictly(kind, data, {"folder": path.resolve().parent})
    except ValidationError as error:
        raise ConfigError(path, problems_of(error, data, kind, place)) from None


def place(location: Location, data: Mapping[str, object]) -> str:
    """`bus 'rtu1', baud` from ("bus", 0, "baud"). Entries of a list of tables go by name, if they have one."""
    parts = list(location)
    if len(parts) >= 2 and isinstance(parts[0], str) and isinstance(parts[1], int):
        section, index = parts[0], parts[1]
        entries = data.get(section)
        entry = entries[index] if isinstance(entries, list) and index < len(entries) else None
        name = entry.get("name") if isinstance(entry, dict) else None
        head = f"{section} '{name}'" if isinstance(name, str) else f"{section} number {index + 1}"
        tail = dotted(parts[2:])
        return f"{head}, {tail}" if tail else head
    if not parts:
        return ""
    depth = 0
    here: object = data
    while depth < len(parts) and isinstance(here, dict) and isinstance(here.get(parts[depth]), dict):
        here = here[parts[depth]]
        depth += 1
    depth = max(depth, 1)
    head, tail = f"[{dotted(parts[:depth])}]", dotted(parts[depth:])
    return f"{head} {tail}" if tail else head
