"""Types of the answers to queries and of commands, and their JSON in UTF-8; changes are compatible as in `messages`."""

from collections.abc import Sequence
from typing import Annotated

from msgspec import Meta, Struct

from drivers.base import Quality
from gateway.model.commands import CommandName
from gateway.telemetry.fields import Coded, GridIndex, Number, Utc, one_of
from gateway.telemetry.messages import PublishedCourse, PublishedReason


class HistoryBlock(Struct, frozen=True):
    """Readings in the order in which they were stored; each column is an array of `rows` little-endian numbers,
    compressed by zlib."""

    rows: int = 0
    first: Annotated[float, Meta(description="The earliest `time`")] = 0.0
    last: Annotated[float, Meta(description="The latest `time`")] = 0.0
    time: Annotated[bytes, Meta(description="float64: when it was read, UTC, seconds since 1970")] = b""
    channel: Annotated[bytes, Meta(description="uint16: one of `numbers`")] = b""
    value: Annotated[bytes, Meta(description="float64; NaN: none")] = b""
    quality: Annotated[bytes, Meta(description="uint8: counts from 0 in `qualities`")] = b""


class HistoryPage(Struct, frozen=True):
    """The answer to a query on `history`: readings as columns of one length, in the order in which they were stored."""

    period_s: Annotated[
        float, Meta(description="0: single readings; 60: means of a minute's good readings, as older ones are kept")
    ]
    names: Annotated[tuple[str, ...], Meta(description="Channels; `channel` counts from 0 in this list")]
    units: Annotated[tuple[str, ...], Meta(description="By channel")]
    time: Annotated[list[float], Meta(description="When it was read, UTC, seconds since 1970")]
    channel: list[int]
    value: list[Number]
    quality: list[Annotated[str, one_of(Quality)]]
    next: Annotated[str | None, Meta(description="`after` of the query for the next page; null: this is the last one")]
    blocks: Annotated[
        tuple[HistoryBlock, ...], Meta(description="Only if asked for: all readings of the page; the columns are empty")
    ] = ()
    numbers: Annotated[tuple[int, ...], Meta(description="What stands for each of `names` in a block")] = ()
    qualities: Annotated[tuple[str, ...], Meta(description="What the numbers in a block's `quality` mean")] = ()


class StoredReason(Struct, frozen=True):
    """What the learner said of one step, as in `reasons`, and what was known then."""

    time: Utc
    k: GridIndex
    errors: dict[str, PublishedReason]
    sigma: Annotated[dict[str, Number], Meta(description="By thermal error: standard uncertainty of that decision")]
    measured: Annotated[Utc | None, Meta(description="When the last measurement that was used had ended")]


class CoursePage(Struct, frozen=True):
    """The answer to a query on `course`: stored estimates and measurements, thinned, oldest first."""

    time: Annotated[list[float], Meta(description="Of the estimates, UTC, seconds since 1970")]
    errors: Annotated[dict[str, PublishedCourse], Meta(description="By thermal error: the estimate at each time")]
    measured_time: list[float]
    measured: Annotated[dict[str, PublishedCourse], Meta(description="By thermal error, at each `measured_time`")]
    residual_um: Annotated[list[Number], Meta(description="At each `measured_time`: as in `measurement`")] = []
    temperatures: Annotated[
        dict[str, list[Number]],
        Meta(description="Only if asked for: by input, degC at each `time`; null: no good value"),
    ] = {}
    reasons: Annotated[
        list[StoredReason], Meta(description="Only if asked for: the latest of the span, up to `limit`, oldest first")
    ] = []
    left: Annotated[
        dict[str, list[Number]],
        Meta(description="By thermal error, at each `measured_time`: found beyond the correction; null: unknown"),
    ] = {}
    inputs: Annotated[
        dict[str, list[Number]],
        Meta(description="Only if asked for: by input that is no temperature, in its unit, at each `time`"),
    ] = {}
    marked: Annotated[
        list[tuple[float, str]],
        Meta(
            description="When problems and orders were, the latest of the span, UTC, seconds since 1970; and the kind"
        ),
    ] = []


class StoredColumn(Struct, frozen=True):
    """One column of rows."""

    name: str
    kind: Annotated[str, one_of(("time", "text", "number", "whole"), "A time is UTC, seconds since 1970")]
    values: Annotated[Sequence[int | float | None], Meta(description="By row; a text's place in `texts`")]
    texts: Annotated[tuple[str, ...], Meta(description="Different ones, counted from 0")] = ()


class StoredTable(Struct, frozen=True):
    """Rows of one table after a position, all of one epoch: where a gateway starts, another one begins."""

    epoch: Annotated[str | None, Meta(description="null: the position's is not known here; there are no rows")] = None
    last: Annotated[int, Meta(description="Number after which the next query goes on, in this epoch")] = 0
    more: Annotated[bool, Meta(description="Whether there are more rows now")] = False
    thinned: Annotated[
        int | None, Meta(description="Rows up to this number were deleted for their age before they were asked for")
    ] = None
    numbers: Annotated[list[int], Meta(description="Of the rows, ascending")] = []
    columns: tuple[StoredColumn, ...] = ()
    problem: Annotated[str, Meta(description="Why this table cannot be read; empty: it can")] = ""


class StoredRows(Struct, frozen=True):
    """The answer to a query on `stored`."""

    tables: dict[str, StoredTable]


class CommandTerms(Struct, frozen=True):
    """The answer to a query on `command`: what a command must contain."""

    machine: str
    challenge: Annotated[str, Meta(description="For one command")]
    valid_s: Annotated[float, Meta(description="How long the challenge is valid")]
    names: Annotated[tuple[str, ...], one_of(CommandName, "The commands that there are")]


class CommandRequest(Struct, frozen=True, forbid_unknown_fields=True):
    """The payload of a query on `command/<name>`; its signature is the attachment."""

    machine: str
    name: Annotated[str, one_of(CommandName)]
    by: Annotated[str, Meta(description="`name` of an operator in the configuration")]
    challenge: str
    nonce: Annotated[str, Meta(description="Random, of the asker", min_length=32, max_length=128)]


class CommandAnswer(Struct, frozen=True):
    """The answer to a command, stored by the gateway; its signature is the attachment."""

    machine: str
    name: Annotated[str, one_of(CommandName)]
    by: str
    time: Utc
    accepted: bool
    text: Annotated[str, Meta(description="What happens now, or why nothing does")]
    text_coded: Coded | None = None


class ReportPage(Struct, frozen=True):
    """The answer to a query on `report`."""

    day: Annotated[str, Meta(description="The local day")]
    zone: Annotated[str, Meta(description="Its time zone; empty: the gateway computer's")]
    page: Annotated[bytes, Meta(description="HTML that loads nothing from elsewhere, compressed with gzip")]


class ScenarioPage(Struct, frozen=True):
    """The answer to a query on `scenario`: what becomes of the learner's estimates if loads run for some minutes from
    now on, and then are again as they are now. Each list has one number for each of `ahead_s`."""

    time: Utc
    k: Annotated[GridIndex, Meta(description="Step that it is made at")]
    ahead_s: Annotated[tuple[float, ...], Meta(description="How far ahead, s")]
    minutes: Annotated[float, Meta(description="How long the loads run")]
    loads: Annotated[dict[str, float], Meta(description="By input, in its unit; empty: it has no such load")]
    stays: Annotated[dict[str, PublishedCourse], Meta(description="By thermal error: if the inputs stay as they are")]
    loaded: Annotated[
        dict[str, PublishedCourse],
        Meta(description="By thermal error: if the loads run; empty: it is not known yet what they do"),
    ]


class QueryRefused(Struct, frozen=True):
    """The error reply to a query that is not answered."""

    error: Annotated[str, Meta(description="What is wrong, and what would be right")]
    coded: Coded | None = None
