"""Assigns the columns: time, thermal errors, inputs. A column that looks like an error never becomes an input."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from gateway.config import suggestion
from gateway.recordings.problems import FileProblems
from talc.names import ERROR_UNITS, MICROMETRE, THERMAL_ERRORS, like_an_error


@dataclass(frozen=True, slots=True)
class Columns:
    """Roles of the file's columns. An error's own name, also with its unit (`EX0C_um`), is recognised."""

    time: str = "time"
    errors: Mapping[str, str] | None = None
    """Thermal error to column."""
    ignored: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Roles:
    """The columns that are used, and those that are not."""

    time: str
    errors: Mapping[str, str]
    """Thermal error to column."""
    inputs: tuple[str, ...]
    ignored: tuple[str, ...]
    """The given ones, and a first column without a name: pandas writes its row numbers there."""


def roles_of(head: Sequence[str], columns: Columns, problems: FileProblems) -> Roles:
    """The role of each column of a heading; contradictions go to `problems`."""
    for number, name in enumerate(head):
        if name in head[:number]:
            problems.add(f"column {number + 1}", f"{name!r} occurs twice")
        elif not name and number:
            problems.add(f"column {number + 1}", "has no name; give it one, then --ignore NAME leaves it out")
    ignored = columns.ignored
    if head[0] == "" and columns.time and "" not in ignored:
        ignored = (*ignored, "")
    if columns.time not in head:
        named = suggestion(columns.time, [name for name in head if name])
        first = 'column 1 has no name: if it is the time, give --time ""; otherwise ' if head[0] == "" else ""
        problems.add(f"column {columns.time!r}", f"is missing (time); {first}{named}")
    errors = dict(columns.errors or {})
    for name in (*errors.values(), *ignored):
        if name not in head:
            problems.add(f"column {name!r}", f"is missing; {suggestion(name, head)}")
    _used_once(columns.time, errors, ignored, problems)
    for error in THERMAL_ERRORS:
        found = [name for name in _own_names(error) if name in head and name not in (*ignored, columns.time)]
        if found and error not in errors:
            errors[error] = found[0]
    taken = {columns.time, *errors.values(), *ignored}
    inputs = tuple(name for name in head if name not in taken)
    for name in inputs:
        _no_error(name, errors, problems)
    if not errors:
        expected = f"expected one or more of {', '.join(THERMAL_ERRORS)}, or --error NAME=COLUMN"
        problems.add("", f"no column of a thermal error; {expected}")
    if not inputs:
        problems.add("", "no column remains as an input")
    return Roles(columns.time, errors, inputs, ignored)


def _own_names(error: str) -> tuple[str, str]:
    return error, error + ("_um" if ERROR_UNITS[error] == MICROMETRE else "_um_per_m")


def _used_once(time: str, errors: Mapping[str, str], ignored: Sequence[str], problems: FileProblems) -> None:
    """No column may have two roles."""
    given = [(time, "the time"), *((name, error) for error, name in errors.items())]
    given += [(name, "left out by --ignore") for name in dict.fromkeys(ignored)]
    first: dict[str, str] = {}
    for name, role in given:
        if name in first:
            problems.add(f"column {name!r}", f"has two roles, {first[name]} and {role}; give it one")
        first.setdefault(name, role)


def _no_error(name: str, errors: Mapping[str, str], problems: FileProblems) -> None:
    """An error among the inputs would explain itself and make every figure meaningless."""
    like = like_an_error(name)
    if like is None:
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
        take = f"--error {f'{like}={name}'!r} takes it as {like} in {ERROR_UNITS[like]}"
        problems.add(where, f"looks like a thermal error{meant} {take}, {leave_out}")
