"""What the options of `replay` say of a recording's columns."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from zoneinfo import ZoneInfo

import click

from gateway.reporting.recordings.columns import Columns
from gateway.reporting.recordings.layout import TextLayout, line_ranges
from gateway.reporting.recordings.times import TIME_UNITS, TimeFormat
from talc.names import THERMAL_ERRORS, like_an_error
from talc.units import COLUMN_UNITS, plain_unit


def columns_of(
    *, time: str, errors: Sequence[str], units: Sequence[str], ignored: tuple[str, ...], inputs: tuple[str, ...],
    time_of_day: str, time_unit: str, time_format: str, time_zone: ZoneInfo | None, runs: str,
    skip: Sequence[str], missing: tuple[str, ...],
) -> Columns:  # fmt: skip
    """What the options say together. Raises click.BadParameter."""
    with _said_by("--time-unit"):
        clock = TimeFormat(time_format, time_zone, unit_of_time(time_unit, time_format))
    with _said_by("--skip"):
        layout = TextLayout(line_ranges(skip), missing)
    with _said_by("--error"):
        named = named_errors(errors)
    with _said_by("--unit"):
        return Columns(time, named, ignored, inputs, named_units(units), clock, time_of_day, runs, layout)


@contextmanager
def _said_by(option: str) -> Iterator[None]:
    try:
        yield
    except ValueError as error:
        raise click.BadParameter(str(error), param_hint=option) from None


def named_errors(pairs: Iterable[str]) -> dict[str, str]:
    """Column of each error, from NAME=COLUMN. Raises ValueError, also for a name that is nearly a thermal error's."""
    found = _pairs(pairs, "NAME=COLUMN")
    for name, column in found.items():
        if name not in THERMAL_ERRORS and like_an_error(name):
            expected = f"expected one of {', '.join(THERMAL_ERRORS)}, or a name that does not look like one"
            raise ValueError(f"{name}={column}: {expected}")
    return found


def named_units(pairs: Iterable[str]) -> dict[str, str]:
    """Unit of each error, from NAME=UNIT. Raises ValueError."""
    found = {name: plain_unit(unit) for name, unit in _pairs(pairs, "NAME=UNIT").items()}
    for name, unit in found.items():
        if unit not in COLUMN_UNITS:
            raise ValueError(f"{name}={unit}: expected one of {', '.join(COLUMN_UNITS)}")
    return found


def unit_of_time(text: str, form: str) -> str:
    """The unit of times that are plain numbers; empty if none is given. Raises ValueError.

    form: how other times are written
    """
    unit = plain_unit(text)
    if unit and unit not in TIME_UNITS:
        raise ValueError(f"{unit!r}: expected one of {', '.join(TIME_UNITS)}")
    if unit and form:
        raise ValueError("is for times that are plain numbers, --time-format for others")
    return unit


def _pairs(pairs: Iterable[str], expected: str) -> dict[str, str]:
    found: dict[str, str] = {}
    for pair in pairs:
        name, equals, text = pair.partition("=")
        if not (name and equals and text):
            raise ValueError(f"{pair!r}: expected {expected}")
        if name in found:
            raise ValueError(f"{name} is given twice: {found[name]!r} and {text!r}")
        found[name] = text
    return found
