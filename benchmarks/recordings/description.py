"""The TOML file beside a recording: the columns' roles and units, their noise, and when the machine was off."""

import tomllib
from collections.abc import Collection, Mapping
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from drivers.problems import problems_of
from drivers.section import NotNegative, Positive
from gateway.config.problems import ConfigError, Problem, place, suggestion
from gateway.reporting.recordings.layout import line_ranges
from gateway.reporting.recordings.times import TIME_UNITS
from talc.names import MICROMETRE_PER_METRE
from talc.units import COLUMN_UNITS, named_unit, plain_unit


def _one_of(units: Collection[str]) -> AfterValidator:
    def spelt(unit: str) -> str:
        plain = plain_unit(unit)
        if plain not in units:
            raise ValueError(f"{unit!r} is invalid; {suggestion(unit, units)}")
        return plain

    return AfterValidator(spelt)


ErrorUnit = Annotated[str, _one_of(COLUMN_UNITS)]
RecordedTimeUnit = Annotated[str, _one_of(TIME_UNITS)]
ColumnKind = Literal["temperature", "speed", "power", "length", "state", "other"]
_TABLES = (".csv", ".parquet")
_NOISE = 0.5
"""Standard deviation of recorded values, if the file states none: µm or µm/m."""


class _DescriptionSection(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class ErrorColumn(_DescriptionSection):
    """One error; fields that are not given here are those given for all."""

    unit: ErrorUnit | None = None
    noise: NotNegative | None = None
    probing: NotNegative | None = None


class InputColumn(_DescriptionSection):
    """One input, or all that a pattern matches."""

    kind: ColumnKind | None = None
    span: Positive | None = None
    """By how much the input typically changes, in its own unit."""


class TimeColumn(_DescriptionSection):
    """The column of times."""

    column: str = "time"
    unit: RecordedTimeUnit = "s"
    """Unit of numeric times; ISO 8601 date-times are recognised."""
    format: str | None = None
    """Format of other date-times, for Python's strptime."""


class Runs(_DescriptionSection):
    """Stretches between which the machine was off."""

    column: str | None = None
    """A column: another value starts another run."""
    gap_min: Positive = 60.0
    """A longer silence also starts one."""
    off_h: NotNegative | tuple[NotNegative, ...] | None = None
    """Hours off before each next run, if each run's time starts again from zero: one for all, or one for each gap."""
    measure_first: bool = True
    """Measure at the beginning of each run."""


class Description(_DescriptionSection):
    """The content of a recording's TOML file."""

    name: str = ""
    file: str = ""
    errors: dict[str, ErrorColumn] = Field(min_length=1)
    inputs: dict[str, InputColumn] = {"*": InputColumn()}
    """By name or pattern; an exact name has precedence over patterns, which apply in their order."""
    ignore: tuple[str, ...] = ()
    """Names or patterns of columns that are neither."""
    skip: tuple[str, ...] = ()
    """Lines that are not of the table, such as "1-11"."""
    missing: tuple[str, ...] = ()
    """Cells that stand for an unknown value, besides the usual ones."""
    unit: ErrorUnit | None = None
    """Of all errors; None: what each column's name states, else µm."""
    noise: NotNegative | None = None
    """Standard deviation of the noise in the recorded errors, in their own unit; None: 0.5 µm or µm/m."""
    probing: NotNegative = 0.0
    """Standard deviation of noise that is added to each measurement that a method receives."""
    seed: int = Field(default=0, ge=0)
    reference: Literal["first", "run", "recorded"] = "first"
    """`first`: each error counts from its first value; `run`: from its first one in each run, a new reference."""
    step_s: Annotated[float, Field(ge=1, le=3600)] = 300.0
    sampling: Literal["mean", "last"] = "mean"
    intervals_min: tuple[Positive, ...] = Field(default=(30.0, 60.0, 120.0, 240.0), min_length=1)
    beginnings_h: tuple[NotNegative, ...] = Field(default=(0.0, 12.0, 24.0), min_length=1)
    time: TimeColumn = TimeColumn()
    runs: Runs = Runs()

    @field_validator("errors", "inputs", mode="before")
    @classmethod
    def _names(cls, value: Any) -> Any:
        """A list of names says nothing else about them."""
        if isinstance(value, list) and all(isinstance(name, str) for name in value):
            return {name: {} for name in value}
        return value

    @model_validator(mode="after")
    def _apart(self) -> Self:
        line_ranges(self.skip)
        twice = [name for name in self.errors if name == self.time.column or self.ignores(name)]
        if twice:
            raise ValueError(f"errors: {twice[0]!r} is also the time or in `ignore`; it can be one of them")
        for name in self.errors:
            named = named_unit(name)
            if (
                self.unit
                and self.errors[name].unit is None
                and named
                and COLUMN_UNITS[named] != COLUMN_UNITS[self.unit]
            ):
                remedy = f'say which one it is in [errors]: {name!r} = {{ unit = "{named}" }}'
                raise ValueError(f"unit: {self.unit!r} is not what the name of {name!r} says, {named}; {remedy}")
        return self

    @property
    def skipped(self) -> tuple[tuple[int, int], ...]:
        """First and last of each range of lines that are left out."""
        return line_ranges(self.skip)

    def ignores(self, column: str) -> bool:
        """Whether a column is left out by name or pattern."""
        return any(fnmatchcase(column, pattern) for pattern in self.ignore)

    def input_of(self, column: str) -> InputColumn | None:
        """The description of a column as an input; None if it is not one."""
        if column in self.inputs:
            return self.inputs[column]
        return next((said for pattern, said in self.inputs.items() if fnmatchcase(column, pattern)), None)

    def unit_of(self, error: str) -> ErrorUnit:
        """Its own, else that of all errors, else what its name states, else µm."""
        return self.errors[error].unit or self.unit or named_unit(error) or "um"

    def scale_of(self, error: str) -> float:
        """µm or µm/m per unit of the error."""
        return COLUMN_UNITS[self.unit_of(error)][1]

    def is_angle(self, error: str) -> bool:
        return COLUMN_UNITS[self.unit_of(error)][0] == MICROMETRE_PER_METRE

    def noise_of(self, error: str) -> float:
        """Standard deviation of the recorded values' own noise, µm or µm/m."""
        own = self.errors[error].noise
        said = self.noise if own is None else own
        return _NOISE if said is None else said * self.scale_of(error)

    def probing_of(self, error: str) -> float:
        """Standard deviation of the added noise, µm or µm/m."""
        said = self.errors[error].probing
        return (self.probing if said is None else said) * self.scale_of(error)


def description_of(path: Path) -> tuple[Description, Path]:
    """The content of a TOML file, and its table. ConfigError names file, field and value."""
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(path, [Problem("", f"is not valid TOML: {error}")]) from None
    try:
        said = Description.model_validate(data)
    except ValidationError as error:
        found = problems_of(error, data, Description, place)
        raise ConfigError(path, [Problem(_plain(p.where, data), p.what) for p in found]) from None
    beside = [path.parent / said.file] if said.file else [path.with_suffix(suffix) for suffix in _TABLES]
    table = next((file for file in beside if file.is_file()), None)
    if table is None:
        expected = " or ".join(file.name for file in beside)
        raise ConfigError(path, [Problem("file", f'{expected} is not beside it; name the recording: file = "NAME"')])
    return said, table


def _plain(where: str, data: Mapping[str, object]) -> str:
    """A field outside any table without the brackets of one."""
    name = where.strip("[]")
    return where if isinstance(data.get(name), dict) else name if where == f"[{name}]" else where


def recordings_in(folder: Path) -> list[Path]:
    """The TOML files of a folder and those in it, by name. ConfigError: none."""
    if not folder.is_dir():
        raise ConfigError(folder, [Problem("", "is not a folder; set RECORDINGS to one with recordings in it")])
    found = sorted(folder.rglob("*.toml"))
    if not found:
        tables = sorted(file.name for file in folder.iterdir() if file.suffix in _TABLES)
        there = f"it contains {', '.join(tables)}; " if tables else ""
        what = f"no TOML file: {there}describe each recording in one beside it (docs/recordings.md)"
        raise ConfigError(folder, [Problem("", what)])
    return found
