"""Assigns the columns: time, thermal errors, inputs. A column that looks like an error never becomes an input."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

from gateway.config.problems import suggestion
from gateway.reporting.recordings.layout import TextLayout
from gateway.reporting.recordings.problems import FileProblems
from gateway.reporting.recordings.times import TimeFormat
from talc.names import (
    ERROR_UNITS,
    MICROMETRE,
    THERMAL_ERRORS,
    called_an_error,
    like_an_error,
    resembles_error,
)
from talc.units import COLUMN_UNITS, named_unit

_INDEX_IN_PARQUET = "__index_level_0__"
"""Name that pandas gives an index without a name in Parquet; in text it has none."""
_NOTHING = '""'


@dataclass(frozen=True, slots=True)
class Columns:
    """Roles of the file's columns. An error's own name, also with its unit (`EX0C_um`), is recognised."""

    time: str = "time"
    errors: Mapping[str, str] | None = None
    """Error, by any name, to column."""
    ignored: tuple[str, ...] = ()
    inputs: tuple[str, ...] = ()
    """Columns that are inputs although they resemble an error."""
    units: Mapping[str, str] = field(default_factory=dict)
    """Error to the unit of its column, one of COLUMN_UNITS; otherwise µm, or µm/m for EA0C, EB0C and EC0C."""
    clock: TimeFormat = field(default_factory=TimeFormat)
    """How the times are written."""
    time_of_day: str = ""
    """Column of the time of day, where the time column contains only the date; empty: none."""
    runs: str = ""
    """Column that differs between runs, each of which may begin with an earlier time; empty: there is one run."""
    layout: TextLayout = field(default_factory=TextLayout)
    """Lines that are left out, and cells without a value."""


@dataclass(frozen=True, slots=True)
class Roles:
    """The columns that are used, and those that are not."""

    time: str
    errors: Mapping[str, str]
    """Error to column."""
    inputs: tuple[str, ...]
    ignored: tuple[str, ...]
    """The given ones, and an index of pandas without a name: its row numbers, if it is not the time."""


def roles_of(head: Sequence[str], columns: Columns, problems: FileProblems) -> Roles:
    """The role of each column of a heading; contradictions go to `problems`."""
    _named_once(head, problems)
    given = dict(columns.errors or {})
    clock = tuple(name for name in (columns.time_of_day, columns.runs) if name)
    ignored, index = columns.ignored, _index_in(head)
    if index is not None and index not in (columns.time, *clock, *given.values(), *columns.inputs, *ignored):
        ignored = (*ignored, index)
    _present(head, columns.time, (*clock, *given.values(), *ignored, *columns.inputs), problems)
    _used_once(columns, given, ignored, problems)
    errors = given | _recognised(head, given, {columns.time, *clock, *given.values(), *columns.inputs, *ignored})
    taken = {columns.time, *clock, *errors.values(), *ignored}
    inputs = tuple(name for name in head if name not in taken)
    for name in inputs:
        if name not in columns.inputs:
            _no_error(name, errors, columns.errors or {}, problems)
    for error, name in errors.items():
        said = named_unit(name)
        if error not in columns.units and said not in ("", "um", "um/m"):
            own = "um" if COLUMN_UNITS[said][0] == MICROMETRE else "um/m"
            what = (
                f"its name says {said}: --unit {f'{error}={said}'!r} reads it so, --unit {f'{error}={own}'!r} does not"
            )
            problems.add(f"column {name!r}", what)
    for error in columns.units:
        if error not in errors:
            problems.add(f"unit of {error}", f"there is no such error; {suggestion(error, list(errors))}")
    if not errors:
        expected = f"expected one or more of {', '.join(THERMAL_ERRORS)}, or --error NAME=COLUMN"
        problems.add("", f"no column of a thermal error; {expected}; columns: {', '.join(filter(None, head))}")
    if not inputs:
        problems.add("", "no column remains as an input")
    return Roles(columns.time, errors, inputs, ignored)


def _index_in(head: Sequence[str]) -> str | None:
    """The column in which pandas writes an index without a name, if there is one."""
    return "" if head[0] == "" else next((name for name in head if name == _INDEX_IN_PARQUET), None)


def _named_once(head: Sequence[str], problems: FileProblems) -> None:
    """Every column but the first must have its own name."""
    before = set[str]()
    for number, name in enumerate(head):
        if name in before:
            problems.add(f"column {number + 1}", f"{name!r} occurs twice")
        elif not name and number:
            problems.add(f"column {number + 1}", "has no name; give it one, then --ignore NAME leaves it out")
        before.add(name)


def _present(head: Sequence[str], time: str, others: Sequence[str], problems: FileProblems) -> None:
    """The columns that the command line names must exist."""
    if time not in head:
        first, index = "", _index_in(head)
        named = suggestion(time, [name for name in head if name and name != index])
        if index is not None:
            which = f"column {index!r} is an index of pandas" if index else "column 1 has no name"
            first = f"{which}: if it is the time, give --time {index or _NOTHING}; otherwise "
        problems.add(f"column {time!r}", f"is missing; --time NAME says which column is the time; {first}{named}")
    for name in others:
        if name not in head:
            problems.add(f"column {name!r}", f"is missing; {suggestion(name, head)}")


def _recognised(head: Sequence[str], given: Mapping[str, str], otherwise: Collection[str]) -> dict[str, str]:
    """The thermal errors whose columns have their names, beside those that are given."""
    found: dict[str, str] = {}
    for error in THERMAL_ERRORS:
        own = [name for name in _own_names(error) if name in head and name not in otherwise]
        if own and error not in given:
            found[error] = own[0]
    return found


def _own_names(error: str) -> tuple[str, str]:
    return error, error + ("_um" if ERROR_UNITS[error] == MICROMETRE else "_um_per_m")


def _used_once(columns: Columns, errors: Mapping[str, str], ignored: Sequence[str], problems: FileProblems) -> None:
    """No column may have two roles."""
    given = [(columns.time, "the time"), *((name, "the time") for name in (columns.time_of_day,) if name)]
    given += [(name, "that of --runs") for name in (columns.runs,) if name]
    given += [(name, error) for error, name in errors.items()]
    given += [(name, "left out by --ignore") for name in dict.fromkeys(ignored)]
    given += [(name, "an input") for name in dict.fromkeys(columns.inputs)]
    first: dict[str, str] = {}
    for name, role in given:
        if name in first:
            problems.add(f"column {name!r}", f"has two roles, {first[name]} and {role}; give it one")
        first.setdefault(name, role)


def without_companions(found: Mapping[int, int], roles: Roles, columns: Columns, problems: FileProblems) -> None:
    """Inputs that were measured in the same few rows as an error are refused, unless they were named as inputs.

    found: number of the input to number of the error.
    """
    measured = tuple(roles.errors.values())
    for i, error in found.items():
        name = roles.inputs[i]
        if name not in columns.inputs:
            what = f"has values only where {measured[error]!r} has them, which is an error; {_role_needed(name)}"
            problems.add(f"column {name!r}", what)


def _role_needed(name: str) -> str:
    what = "as an input it may explain the error by itself. "
    what += f"--error {f'NAME={name}'!r} takes it as an error, --ignore {name!r} leaves it out, "
    return what + f"--input {name!r} takes it as an input"


def _no_error(name: str, errors: Mapping[str, str], given: Mapping[str, str], problems: FileProblems) -> None:
    """An error among the inputs would explain itself and make every figure meaningless.

    given: the errors whose columns the user named: their neighbours are errors too, as likely as not.
    """
    like = like_an_error(name)
    if like is None:
        alike = next((column for column in given.values() if resembles_error(name, column, letters=True)), None)
        if alike is not None:
            problems.add(f"column {name!r}", f"resembles {alike!r}, which is an error; {_role_needed(name)}")
        elif called_an_error(name):
            problems.add(f"column {name!r}", f"is an error by its name; {_role_needed(name)}")
        return
    where = f"column {name!r}"
    leave_out = f"--ignore {name!r} leaves it out"
    if like not in THERMAL_ERRORS:
        problems.add(where, f"looks like an error, and errors are not inputs; {leave_out}, or rename it")
    elif like in errors:
        problems.add(where, f"looks like {like}, which is column {errors[like]!r} already; {leave_out}")
    else:
        own, exact = _own_names(like)
        meant = "" if name in (own, exact) else f"; did you mean {own!r}?"
        take = f"--error {f'{like}={name}'!r} takes it as {like} in {_unit_of(name, like)}"
        problems.add(where, f"looks like a thermal error{meant} {take}, {leave_out}")


def _unit_of(name: str, error: str) -> str:
    """The unit that a column's name ends with, and how to say it; otherwise the error's own."""
    found = named_unit(name)
    if not found or COLUMN_UNITS[found][0] != ERROR_UNITS[error] or COLUMN_UNITS[found][1] == 1.0:
        return ERROR_UNITS[error]
    return f"{found} (with --unit {error}={found})"
