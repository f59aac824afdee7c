"""Problems of a file or a table, one per line: where, which value, and what is expected."""

import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, is_dataclass, replace
from dataclasses import fields as dataclass_fields
from difflib import get_close_matches
from types import UnionType
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from drivers.base import SetupError
from drivers.section import WRONG, strictly

Location = Sequence[str | int]
M = TypeVar("M", bound=BaseModel)


@dataclass(frozen=True, slots=True)
class Problem:
    """One mistake. `where` names the field for a person, such as `device 'rtd1', unit`."""

    where: str
    what: str
    expected: str = ""
    """The end of `what`, if that says what is expected."""

    def __str__(self) -> str:
        text = f"{self.where}: {self.what}" if self.where else self.what
        # One line per problem, whatever characters the file holds.
        return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def suggestion(wrong: str, right: Iterable[str]) -> str:
    """`did you mean 'baud'?`, or the possible names when none is close."""
    names = sorted(right)
    begun = [name for name in names if wrong and name.startswith(wrong)]
    if len(begun) > 1:
        return f"did you mean {' or '.join(repr(name) for name in begun)}?"
    close = get_close_matches(wrong, names, n=1, cutoff=0.6)
    if close:
        return f"did you mean '{close[0]}'?"
    return f"possible: {', '.join(names)}" if names else "none is possible here"


def shown(value: object) -> str:
    """A value as it would be written in the file, shortened when long."""
    if isinstance(value, bool):
        return str(value).lower()
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def toml_data(text: str) -> dict[str, object]:
    """The data of a TOML file. Raises ValueError if the text is not TOML, or has values that cannot be shown."""
    try:
        data = tomllib.loads(text)
        repr(data)  # an integer of thousands of digits cannot be written
    except RecursionError:
        raise ValueError("brackets are nested too deeply") from None
    return data


def read_settings(
    kind: type[M], data: Mapping[str, object], context: Mapping[str, object] | None = None,
    *, file: str = "", bus: str = "", device: str = "",
) -> M:  # fmt: skip
    """The settings, options or profile that TOML's data describe; for `context` see `strictly`.

    Raises SetupError naming file, bus or device, and every invalid field with its value and what is expected.
    """
    try:
        return strictly(kind, data, context)
    except ValidationError as error:
        found = _in_one_line(error, data, kind)
        raise SetupError(f"{file}: {found}" if file else found, bus=bus, device=device) from error


def settings_of(kind: type[M], values: Mapping[str, object]) -> M:
    """The settings from these Python values. Raises SetupError as `read_settings` does."""
    try:
        return kind.model_validate(values)
    except ValidationError as error:
        raise SetupError(_in_one_line(error, values, kind)) from error


def _in_one_line(error: ValidationError, data: Mapping[str, object], kind: type[BaseModel]) -> str:
    return "; ".join(map(str, problems_of(error, data, kind, lambda location, _: dotted(location))))


def problems_of(
    error: ValidationError,
    data: Mapping[str, object],
    root: type[BaseModel],
    place: Callable[[Location, Mapping[str, object]], str],
) -> list[Problem]:
    """Pydantic's findings in the words of the file.

    place: returns a field's place for a person, from its location in the data
    """
    # A default derived from an invalid field is not a second mistake.
    details = [d for d in error.errors(include_url=False) if d["type"] != "default_factory_not_called"]
    meant = {(*d["loc"][:-1], name) for d in details if d["type"] == "missing" if (name := _misspelt(d, details))}
    found: dict[str, Problem] = {}
    for detail in details:
        if detail["type"] == "extra_forbidden" and detail["loc"] in meant:
            continue  # already reported where it is missing
        problem = _problem(detail, details, data, root, place)
        known = found.get(problem.where)
        if known is None:
            found[problem.where] = problem
        elif known.expected and problem.expected:  # each member of a union reports it
            found[problem.where] = replace(known, what=f"{known.what} or {problem.expected}")
    return list(found.values())


def _misspelt(missing: ErrorDetails, details: Iterable[ErrorDetails]) -> str | None:
    """The unknown key beside the missing one that may have been meant."""
    *table, key = missing["loc"]
    beside = (d["loc"] for d in details if d["type"] == "extra_forbidden")
    close = get_close_matches(str(key), [str(loc[-1]) for loc in beside if list(loc[:-1]) == table], n=1)
    return close[0] if close else None


def dotted(parts: Location) -> str:
    """`status.rule[1].bit`."""
    return "".join(f"[{p}]" if isinstance(p, int) else f".{p}" for p in parts).removeprefix(".")


def _problem(
    detail: ErrorDetails,
    details: Iterable[ErrorDetails],
    data: Mapping[str, object],
    root: type[BaseModel],
    place: Callable[[Location, Mapping[str, object]], str],
) -> Problem:
    location = _without_tags(detail["loc"], data)
    kind, value, context = detail["type"], detail.get("input"), detail.get("ctx", {})
    if kind == WRONG:
        at = _without_tags((*detail["loc"], *context["at"]), data)
        return Problem(place(at, data), str(context["what"]))
    where = place(location, data)
    key = str(location[-1]) if location else ""
    match kind:
        case "extra_forbidden" | "unexpected_keyword_argument":
            holder = list(_annotations(root, detail["loc"][:-1]))
            return Problem(where, f"unknown key; {suggestion(key, _keys(holder))}")
        case "missing":
            if (other := _misspelt(detail, details)) is not None:
                return Problem(where, f"missing; is '{other}' meant to be it?")
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
            return Problem(where, f"{shown(value)} is invalid; {suggestion(value, choices)}")
        case _:
            return _expecting(where, value, kind, context, detail["msg"])


def _expecting(where: str, value: object, kind: str, context: Mapping[str, Any], message: str) -> Problem:
    wanted = _expected(kind, context)
    if wanted:
        return Problem(where, f"{shown(value)}: expected {wanted}", wanted)
    match kind:
        case "too_short":
            wrong = f"has {context['actual_length']} entries, expected at least {context['min_length']}"
        case "too_long":
            wrong = f"has {context['actual_length']} entries, expected at most {context['max_length']}"
        case _:
            wrong = message[:1].lower() + message[1:]
    return Problem(where, f"{shown(value)}: {wrong}")


def _expected(kind: str, context: Mapping[str, Any]) -> str:
    """Empty: it is not said so."""
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
        return wanted[kind]
    limits = {"greater_than": ("gt", "more than"), "greater_than_equal": ("ge", "at least")}
    limits |= {"less_than": ("lt", "less than"), "less_than_equal": ("le", "at most")}
    if kind in limits:
        name, words = limits[kind]
        return f"{words} {context[name]:g}"
    return _plain(context["expected"]) if kind == "literal_error" else ""


def _plain(text: object) -> str:
    return str(text).replace("'", "")


def _without_tags(location: Location, data: object) -> tuple[str | int, ...]:
    """The field's location in the file; Pydantic's also contains the chosen member of a union."""
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


def _annotations(root: object, location: Location) -> Iterator[object]:
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
        if following or not isinstance(part, str):  # otherwise it is the tag of a union, which is not in the file
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
    """Keys as they are written in the file, and their types."""
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
