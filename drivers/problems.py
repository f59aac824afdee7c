"""Problems of a file or a table, one per line: where, which value, and what is expected."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, is_dataclass, replace
from dataclasses import fields as dataclass_fields
from difflib import get_close_matches
from itertools import islice
from types import UnionType
from typing import Annotated, Any, Literal, Protocol, TypeVar, Union, get_args, get_origin, runtime_checkable

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from drivers.base import DriverError, SetupError, dotted
from drivers.section import strictly
from drivers.text import Text, plain, shown, text_of

Location = Sequence[str | int]
_MOST_HOMES = 3
_MOST_TOLD = 100
_LONGEST_NAME = 100
_CLOSE, _CLOSE_KIND = 0.75, 0.8
_SHORT = 2
_TABLES = ("model_type", "model_attributes_type", "dataclass_type", "dict_type")
M = TypeVar("M", bound=BaseModel)


@dataclass(frozen=True, slots=True)
class Spot:
    """A line of a file, and what it is in the file's data."""

    line: int
    """Counted from 1."""
    source: str
    """The line as it stands."""
    section: str = ""
    """Its section as the file names it, such as `[grid]` or `device 'rtd1'`; empty: the file is no TOML."""
    field: str = ""
    """The field within it, such as `channels.bed_front`; empty: the whole section."""
    value: object = None
    """The field's value; None: it is missing."""


@dataclass(frozen=True, slots=True)
class Problem:
    """One mistake. `where` names the field for a person, such as `device 'rtd1', unit`."""

    where: str
    what: str
    within: Location = ()
    """The wrong field within `where`."""
    expected: str = ""
    """The end of `what`, if that says what is expected."""
    at: Spot | None = field(default=None, compare=False)
    """Where it is in the file's text, if that is known."""

    def __str__(self) -> str:
        return _one_line(self.text)

    def in_language(self, language: str) -> str:
        """In one line."""
        return _one_line(self.text.in_language(language))

    @property
    def text(self) -> Text:
        """Where, and what."""
        return Text("place_problem", where=self.place, what=plain(self.what)) if self.place else plain(self.what)

    @property
    def place(self) -> str:
        """`where` with the field."""
        joint = " " if self.where.endswith("]") else ", "
        return joint.join(part for part in (self.where, dotted(self.within)) if part)


@runtime_checkable
class NamesField(Protocol):
    """An error of a package that knows no catalogue."""

    field: str
    value: object
    expected: str
    """In English."""


def _one_line(text: str) -> str:
    """Whatever characters the file holds."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def suggestion(wrong: str, right: Iterable[str], close: float = 0.6) -> str:
    """`did you mean 'baud'?`, or the possible names when none is as close as `close`, from 0 to 1."""
    names = sorted(right)
    begun = [name for name in names if wrong and name.startswith(wrong)]
    within = begun or [name for name in names if wrong in name.split("_")]
    if len(within) > 1:
        return Text("mean_one_of", names=" or ".join(repr(name) for name in within))
    if begun:
        return Text("mean", name=begun[0])
    cutoff = close if len(wrong) > _SHORT else _CLOSE_KIND
    alike = {name.lower().replace("-", "_"): name for name in names}
    if found := get_close_matches(wrong[:_LONGEST_NAME].lower().replace("-", "_"), alike, n=1, cutoff=cutoff):
        return Text("mean", name=alike[found[0]])
    return Text("possible", names=", ".join(names)) if names else Text("none_possible")


def read_settings(
    kind: type[M], data: Mapping[str, object], context: Mapping[str, object] | None = None,
    *, file: str = "", bus: str = "", device: str = "", line_of: Callable[[Location], int] | None = None,
) -> M:  # fmt: skip
    """The settings, options or profile that TOML's data describe; for `context` see `strictly`.

    line_of: the line of the file on which a location is; 0: unknown

    Raises SetupError naming file, bus or device, and every invalid field with its value and what is expected.
    """
    try:
        return strictly(kind, data, context)
    except ValidationError as error:
        what, field = _in_one_line(error, data, kind)
        if file:
            what = Text("at_field", field=dotted(field), what=what) if field else what
            lines = [] if line_of is None else [line_of(each.within) for each in problems_of(error, data, kind)]
            file = f"{file}:{first}" if (first := min(filter(None, lines), default=0)) else file
            what, field = Text("in_file", file=file, what=what), ()
        raise SetupError(what, field=field, bus=bus, device=device) from error


def settings_of(kind: type[M], values: Mapping[str, object]) -> M:
    """The settings from these Python values. Raises SetupError as `read_settings` does."""
    try:
        return kind.model_validate(values)
    except ValidationError as error:
        what, field = _in_one_line(error, values, kind)
        raise SetupError(what, field=field) from error


def _in_one_line(error: ValidationError, data: Mapping[str, object], kind: type[BaseModel]) -> tuple[Text, Location]:
    """What is wrong, and the field that has it, if it is a single one."""
    problems = problems_of(error, data, kind)
    if len(problems) == 1:
        return plain(problems[0].what), problems[0].within
    return Text("several", problems=[problem.text for problem in problems]), ()


def problems_of(
    error: ValidationError,
    data: Mapping[str, object],
    root: type[BaseModel],
    place: Callable[[Location, Mapping[str, object]], str] | None = None,
) -> list[Problem]:
    """Pydantic's first hundred findings, as the file names things; each has `within` only.

    place: makes `where`, for a person, of `within`, its location in the data
    """
    # A default derived from an invalid field is not a second mistake.
    whole = (d for d in error.errors(include_url=False) if d["type"] != "default_factory_not_called")
    details = list(islice(whole, _MOST_TOLD))
    # Nor is the length of a list with invalid entries.
    around = {d["loc"][:length] for d in details for length in range(len(d["loc"]))}
    details = [d for d in details if d["type"] != "too_short" or d["loc"] not in around]
    meant = {(*d["loc"][:-1], name) for d in details if d["type"] == "missing" if (name := _misspelt(d, details))}
    found: dict[Location, Problem] = {}
    for detail in details:
        if detail["type"] == "extra_forbidden" and detail["loc"] in meant:
            continue  # already reported where it is missing
        problem = _problem(detail, details, data, root)
        known = found.get(problem.within)
        if known is None:
            found[problem.within] = problem
        elif known.expected and problem.expected:  # each member of a union reports it
            found[problem.within] = replace(known, what=Text("either", one=known.what, other=problem.expected))
    if place is None:
        return list(found.values())
    return [replace(problem, where=place(problem.within, data), within=()) for problem in found.values()]


def _misspelt(missing: ErrorDetails, details: Iterable[ErrorDetails]) -> str | None:
    """The unknown key beside the missing one that may have been meant."""
    *table, key = missing["loc"]
    beside = (d["loc"] for d in details if d["type"] == "extra_forbidden")
    close = get_close_matches(str(key), [str(loc[-1]) for loc in beside if list(loc[:-1]) == table], n=1)
    return close[0] if close else None


def _problem(
    detail: ErrorDetails, details: Iterable[ErrorDetails], data: Mapping[str, object], root: type[BaseModel]
) -> Problem:
    location = _without_tags(detail["loc"], data)
    kind, value, context = detail["type"], detail.get("input"), detail.get("ctx", {})
    types = list(_annotations(root, detail["loc"]))
    match kind:
        case "extra_forbidden" | "unexpected_keyword_argument":
            holder = list(_annotations(root, detail["loc"][:-1]))
            what = _unknown_key(location, holder, root, table=isinstance(value, dict))
        case "missing":
            if (other := _misspelt(detail, details)) is not None:
                what = Text("missing_misspelt", other=other)
            else:
                what = Text("missing_no_default") if isinstance(location[-1], str) else Text("missing_entries")
        case "union_tag_not_found":
            what = Text("missing_kind", advice=suggestion("", _tags(types)))
        case "union_tag_invalid":
            location, tag = (*location, "kind"), str(context.get("tag"))
            what = Text("unknown_kind", tag=tag, advice=suggestion(tag, _tags(types), _CLOSE_KIND))
        case "value_error" if isinstance(error := context.get("error"), Exception):
            field, what = _raised(error)
            location = (*location, *field)
        case "literal_error":
            choices = _choices(types)
            if isinstance(value, str) and (texts := [choice for choice in choices if isinstance(choice, str)]):
                return Problem("", Text("invalid", value=shown(value), advice=suggestion(value, texts)), location)
            wanted = Text("one_of", names=[str(choice) for choice in choices])
            return Problem("", Text("expected", value=shown(value), wanted=wanted), location, wanted)
        case _ if (brackets := _other_brackets(types, value, kind)) is not None:
            what = Text(brackets, name=".".join(part for part in location if isinstance(part, str)))
        case _:
            wrong = _expecting(value, kind, context, detail["msg"])
            example = _example(location, types, value) if kind in _TABLES else _listed(types, value, kind)
            what = Text("such_as", wanted=wrong.what, example=example) if example else plain(wrong.what)
            return Problem("", what, location, wrong.expected)
    return Problem("", what, location)


def _other_brackets(types: Iterable[object], value: object, kind: str) -> str | None:
    """Code of the advice for a section that needs the other brackets; None: it is another mistake."""
    if kind in _TABLES and isinstance(value, list) and value and isinstance(value[0], dict):
        return "toml_single"
    entries = [get_args(member)[0] for member in types if get_origin(member) is tuple]
    tables = any(isinstance(each, type) and _fields(each) for entry in entries for each in _members(entry))
    return "toml_several" if tables and kind == "tuple_type" and isinstance(value, dict) else None


def _raised(error: Exception) -> tuple[Location, Text]:
    """The field below a validator's own that its error names, and what it says."""
    if isinstance(error, NamesField):
        return (error.field,), Text("expected", value=shown(error.value), wanted=plain(error.expected))
    return (error.field, error.advice) if isinstance(error, DriverError) else ((), text_of(error))


def _unknown_key(location: Location, holder: Sequence[object], root: type[BaseModel], *, table: bool) -> Text:
    key, section_of = str(location[-1]), str(location[0])
    homes = [
        title + (f" of kind '{kind}'" if kind else "")
        for title, kind, names, section in _sections(root)
        if key in names
        and section not in holder
        # what some kinds of another section have is far away
        and (not kind or not len(location) > 1 or not isinstance(location[1], str) or title == f"[{section_of}]")
    ]
    if homes and not get_close_matches(key, _keys(holder), n=1, cutoff=_CLOSE):
        if table:
            homes = [f"[{title.partition(']')[0].strip('[')}.{key}]" for title in homes]
        nearest = sorted(dict.fromkeys(homes), key=lambda title: title.count("."))
        return Text("unknown_key_elsewhere", sections=" or ".join(nearest[:_MOST_HOMES]))
    return Text("unknown_key", advice=suggestion(key, _keys(holder)))


def _expecting(value: object, kind: str, context: Mapping[str, Any], message: str) -> Problem:
    wanted = _expected(kind, context)
    if wanted:
        return Problem("", Text("expected", value=shown(value), wanted=wanted), expected=wanted)
    match kind:
        case "too_short":
            wrong = Text("few_entries", count=context["actual_length"], least=context["min_length"])
        case "too_long":
            wrong = Text("many_entries", count=context["actual_length"], most=context["max_length"])
        case _:
            wrong = plain(message[:1].lower() + message[1:])
    return Problem("", Text("value_wrong", value=shown(value), wrong=wrong))


def _expected(kind: str, context: Mapping[str, Any]) -> str:
    """Empty: it is not said so."""
    wanted = {
        "string_type": Text("a_text"),
        "int_type": Text("a_whole_number"),
        "int_from_float": Text("a_whole_number"),
        "float_type": Text("a_number"),
        "bool_type": Text("a_truth"),
        "model_type": Text("a_table"),
        "model_attributes_type": Text("a_table"),
        "dataclass_type": Text("a_table"),
        "dict_type": Text("a_table"),
        "tuple_type": Text("a_list"),
        "path_type": Text("a_path"),
        "finite_number": Text("a_finite_number"),
        "string_too_short": Text("a_full_text"),
    }
    if kind in wanted:
        return wanted[kind]
    limits = {"greater_than": ("gt", "more_than"), "greater_than_equal": ("ge", "at_least")}
    limits |= {"less_than": ("lt", "less_than"), "less_than_equal": ("le", "at_most")}
    if kind in limits:
        name, code = limits[kind]
        return Text(code, limit=context[name])
    return ""


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


def _sections(holder: type, path: str = "") -> Iterator[tuple[str, str, Iterable[str], type]]:
    """Title, kind if there are several, keys and class of every section in a section, as the file has it; of an array
    or a map by its own key too."""
    for key, annotation in _fields(holder).items():
        here = f"{path}.{key}".removeprefix(".")
        for member in (members := list(_members(annotation))):
            origin = get_origin(member)
            listed, mapped = origin is tuple, origin is Mapping
            inner = list(_members(get_args(member)[0 if listed else 1])) if listed or mapped else [member]
            kinds = len(_tags(inner if len(inner) > 1 else members))
            for each in inner:
                if not isinstance(each, type) or not (fields := _fields(each)):
                    continue
                title = f"[[{here}]]" if listed else f"[{here}.NAME]" if mapped else f"[{here}]"
                yield title, _tag(each) or "" if kinds > 1 else "", [*fields, key] if mapped else fields, each
                yield from _sections(each, here)


def _example(location: Location, wanted: Iterable[object], value: object) -> str:
    """What a table could be in place of this value; empty: its keys are not known."""
    given = value if isinstance(value, list) else [] if isinstance(value, dict) else [value]
    for member in wanted:
        mapped = get_origin(member) is Mapping
        for each in _members(get_args(member)[1]) if mapped else (member,):
            if mapped and not (isinstance(each, type) and _fields(each)):
                return "{NAME = …}"
            if isinstance(each, type) and (fields := list(_fields(each))):
                shown_values = [*map(shown, given), *("…" for _ in fields)]
                pairs = [f"{name} = {text}" for name, text in zip(fields, shown_values, strict=False)]
                table = ", ".join(pairs[: max(2, len(given))])
                return f"{dotted((*location, 'NAME'))} = {{{table}}}" if mapped else f"{{{table}}}"
    return ""


def _listed(wanted: Iterable[object], value: object, kind: str) -> str:
    """What a list could be in place of its first value; empty: it cannot be told."""
    for member in wanted if kind == "tuple_type" else ():
        if get_origin(member) is tuple:
            fits = not isinstance(value, dict) and isinstance(value, str) == (str in _members(get_args(member)[0]))
            rest = [each for each in get_args(member)[1:] if each is not Ellipsis]
            return f"[{', '.join([shown(value) if fits else '…', *('…' for _ in rest)])}]"
    return ""


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


def _tags(types: Iterable[object]) -> list[str]:
    return [tag for member in types if (tag := _tag(member))]


def _choices(types: Iterable[object]) -> list[object]:
    return [choice for member in types if get_origin(member) is Literal for choice in get_args(member)]


def _keys(types: Iterable[object]) -> set[str]:
    return {key for member in types if isinstance(member, type) for key in _fields(member)}
