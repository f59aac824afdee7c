"""Problems of a configuration, one per line, with the file's name and the place as the file names it."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ValidationError

from drivers.problems import Location, Problem, dotted, problems_of, shown, suggestion
from drivers.section import strictly

__all__ = ["ConfigError", "Problem", "place", "read_sections", "shown", "suggestion"]

M = TypeVar("M", bound=BaseModel)


class ConfigError(Exception):
    """The configuration cannot be used. The text has one line per problem, each beginning with the file's name."""

    def __init__(self, file: Path, problems: Sequence[Problem]) -> None:
        self.file, self.problems = file, tuple(problems)
        super().__init__("\n".join(f"{file}: {problem}" for problem in self.problems))


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
