"""What is wrong with a configuration, one clear line each: file, place, value, what would be right."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, is_dataclass
from dataclasses import fields as dataclass_fields
from difflib import get_close_matches
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails


@dataclass(frozen=True, slots=True)
class Problem:
    """One mistake. `where` is the field's place for a person, such as `device 'rtd1', unit`."""

    where: str
    what: str

    def __str__(self) -> str:
        text = f"{self.where}: {self.what}" if self.where else self.what
        # One line per problem, whatever characters the file holds.
        return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


class ConfigError(Exception):
    """The configuration cannot be used. The text has one line per problem, each beginning with the file's name."""

    def __init__(self, file: Path, problems: Sequence[Problem]) -> None:
        self.file, self.problems = file, tuple(problems)
        super().__init__("\n".join(f"{file}: {problem}" for problem in self.problems))


def suggestion(wrong: str, right: Iterable[str]) -> str:
    """`did you mean 'baud'?`, or the possible names when none is close."""
    names = sorted(right)
    close = get_close_matches(wrong, names, n=1, cutoff=0.6)
    if close:
        return f"did you mean '{close[0]}'?"
    return f"possible: {', '.join(names)}" if names else "none is possible here"


def shown(value: object) -> str:
    """A value as the file would have it, cut when long."""
    if isinstance(value, bool):
        return str(value).lower()
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def problems_of(error: ValidationError, data: Mapping[str, object], root: type[BaseModel]) -> list[Problem]:
    """Pydantic's findings in the words of the file."""
    found: dict[str, Problem] = {}
    for problem in (_problem(detail, data, root) for detail in error.errors(include_url=False)):
        known = found.get(problem.where)
        if known is None:
            found[problem.where] = problem
        elif ": expected " in known.what and ": expected " in problem.what:  # each member of a union complains
            found[problem.where] = Problem(known.where, f"{known.what} or {problem.what.split(': expected ', 1)[1]}")
    return list(found.values())


def place(location: Sequence[str | int], data: Mapping[str, object]) -> str:
    """`bus 'rtu1', baud` from ("bus", 0, "baud"). Entries of a list of tables go by their name, if they have one."""
    parts = list(location)
    if len(parts) >= 2 and isinstance(parts[0], str) and isinstance(parts[1], int):
        section, index = parts[0], parts[1]
        entries = data.get(section)
        entry = entries[index] if isinstance(entries, list) and index < len(entries) else None
        name = entry.get("name") if isinstance(entry, dict) else None
        head = f"{section} '{name}'" if isinstance(name, str) else f"{section} number {index + 1}"
        tail = _path(parts[2:])
        return f"{head}, {tail}" if tail else head
    if not parts:
        return ""
    depth = 0
    here: object = data
    while depth < len(parts) and isinstance(here, dict) and isinstance(here.get(parts[depth]), dict):
        here = here[parts[depth]]
        depth += 1
    depth = max(depth, 1)
    head, tail = f"[{_path(parts[:depth])}]", _path(parts[depth:])
    return f"{head} {tail}" if tail else head


def _path(parts: Sequence[str | int]) -> str:
    return "".join(f"[{p}]" if isinstance(p, int) else f".{p}" for p in parts).removeprefix(".")


def _problem(detail: ErrorDetails, data: Mapping[str, object], root: type[BaseModel]) -> Problem:
    location = _without_tags(detail["loc"], data)
    where, kind, value = place(location, data), detail["type"], detail.get("input")
    context = detail.get("ctx", {})
    key = str(location[-1]) if location else ""
    match kind:
        case "extra_forbidden" | "unexpected_keyword_argument":
            holder = list(_annotations(root, detail["loc"][:-1]))
            return Problem(where, f"unknown key; {suggestion(key, _keys(holder))}")
        case "missing":
            return Problem(
                where, "missing; " + ("it has no default" if isinstance(location[-1], str) else "too few entries")
            )
        case "union_tag_not_found":
            holder = list(_annotations(root, detail["loc"]))
            return Problem(where, f"kind is missing; {suggestion('', [t for m in holder if (t := _tag(m))])}")
        case "union_tag_invalid":
            tags = re.findall(r"'([^']+)'", str(context.get("expected_tags", "")))
            tag = str(context.get("tag"))
            return Problem(f"{where}, kind", f"unknown kind '{tag}'; {suggestion(tag, tags)}")
        case "value_error":
            return Problem(where, str(context.get("error", detail["msg"])))
        case "literal_error" if isinstance(value, str):
            choices = re.findall(r"'([^']+)'", str(context.get("expected", "")))
            return Problem(where, f"{shown(value)} is not possible; {suggestion(value, choices)}")
        case _:
            return Problem(where, f"{shown(value)}: {_expected(kind, context, detail['msg'])}")


def _expected(kind: str, context: Mapping[str, Any], message: str) -> str:
    wanted = {
        "string_type": "a text in quotes",
        "int_type": "a whole number",
        "int_from_float": "a whole number",
        "float_type": "a number",
        "bool_type": "true or false",
        "model_type": "a table",
        "model_attributes_type": "a table",
        "dataclass_type": "a table",
        "dict_type": "a table",
        "tuple_type": "a list",
        "path_type": "a path in quotes",
        "finite_number": "a finite number",
        "string_too_short": "a text that is not empty",
    }
    if kind in wanted:
        return f"expected {wanted[kind]}"
    limits = {"greater_than": ("gt", "more than"), "greater_than_equal": ("ge", "at least")}
    limits |= {"less_than": ("lt", "less than"), "less_than_equal": ("le", "at most")}
    if kind in limits:
        name, words = limits[kind]
        return f"expected {words} {context[name]:g}"
    match kind:
        case "too_short":
            return f"has {context['actual_length']} entries, expected at least {context['min_length']}"
        case "too_long":
            return f"has {context['actual_length']} entries, expected at most {context['max_length']}"
        case "literal_error":
            return f"expected {_plain(context['expected'])}"
    return message[:1].lower() + message[1:]


def _plain(text: object) -> str:
    return str(text).replace("'", "")


def _without_tags(location: Sequence[str | int], data: object) -> tuple[str | int, ...]:
    """Pydantic puts the chosen member of a union into the location; the file has no such level."""
    kept: list[str | int] = []
    here = data
    for index, part in enumerate(location):
        last = index == len(location) - 1
        if isinstance(here, dict):
            inside = part in here
            if not inside and not last:
                continue
            if not inside and last and here.get("kind") == part:
                continue
            kept.append(part)
            here = here.get(part) if isinstance(part, str) else None
        elif isinstance(here, list) and isinstance(part, int):
            kept.append(part)
            here = here[part] if part < len(here) else None
        elif isinstance(part, int):
            kept.append(part)
    return tuple(kept)


def _annotations(root: object, location: Sequence[str | int]) -> Iterator[object]:
    """The types that can stand at a location."""
    types: list[object] = [root]
    for part in location:
        following: list[object] = []
        for member in (m for t in types for m in _members(t)):
            if isinstance(member, type) and (fields := _fields(member)):
                if part in fields:
                    following.append(fields[str(part)])
                elif part == _tag(member):
                    following.append(member)
            elif get_origin(member) is tuple and isinstance(part, int):
                following.append(get_args(member)[0])
            elif get_origin(member) is Mapping:
                following.append(get_args(member)[1])
        types = following
    yield from (m for t in types for m in _members(t))


def _members(annotation: object) -> Iterator[object]:
    origin = get_origin(annotation)
    if origin is Annotated:
        yield from _members(get_args(annotation)[0])
    elif origin in (Union, UnionType):
        for member in get_args(annotation):
            yield from _members(member)
    else:
        yield annotation


def _fields(section: type) -> dict[str, object]:
    """Keys as the file has them, and their types."""
    if issubclass(section, BaseModel):
        return {f.alias or name: f.annotation for name, f in section.model_fields.items()}
    if is_dataclass(section):
        return {f.name: f.type for f in dataclass_fields(section)}
    return {}


def _tag(section: object) -> str | None:
    if not (isinstance(section, type) and issubclass(section, BaseModel)):
        return None
    field = section.model_fields.get("kind")
    choices = get_args(field.annotation) if field is not None else ()
    return str(choices[0]) if choices else None


def _keys(types: Iterable[object]) -> set[str]:
    return {key for member in types if isinstance(member, type) for key in _fields(member)}
