"""Queries on a span of time: on `history` for stored readings, page by page, on `course` for thinned estimates."""

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime

from gateway.telemetry.answers import CoursePage, HistoryPage
from gateway.telemetry.codec import encode
from gateway.telemetry.queries import MOST_ROWS, Answering, Replied, limit_of, parameters_of

_MOST_ESTIMATES = 2000
_KNOWN = ("from", "to", "channels", "limit", "after", "every", "form")
_MOST_IN_BLOCKS = 500_000
"""Readings of one page of blocks; each takes three to nine bytes there."""
_ALSO = ("temperatures", "reasons", "inputs")
"""What a query on `course` may ask for besides."""
_LONGEST_S = 3600
_LONGEST_MINUTES_S = 86_400


@dataclass(frozen=True, slots=True)
class HistoryRequest:
    """What a query on `history` asks for."""

    begin: datetime
    end: datetime
    channels: tuple[str, ...] | None
    """None: all."""
    limit: int
    after: str | None
    """`next` of the previous page; None: from the beginning."""
    every_s: int | None = None
    """Length of the intervals of which means are wanted; None: the readings as they are stored."""
    blocks: bool = False
    """Whether the readings are wanted as compressed columns; a page then ends with a block."""


HistorySource = Callable[[HistoryRequest], HistoryPage]
"""Finds a page. Raises ValueError when the request is wrong, OSError when there is nothing to read from."""


def history_answer(source: HistorySource) -> Answering:
    """What answers queries with pages of this source."""
    return lambda asked: Replied(encode(source(parse_selector(asked.parameters))))


@dataclass(frozen=True, slots=True)
class CourseRequest:
    """What a query on `course` asks for."""

    begin: datetime
    end: datetime
    limit: int
    """Estimates, and measurements."""
    temperatures: bool = False
    """Whether the temperatures at the times of the estimates are wanted, too."""
    reasons: bool = False
    """Whether the learner's reasons are wanted, too."""
    inputs: bool = False
    """Whether the other inputs are wanted, too, such as loads."""


CourseSource = Callable[[CourseRequest], CoursePage]
"""Finds estimates. Raises OSError when there is nothing to read from."""


def course_answer(source: CourseSource) -> Answering:
    """What answers queries on `course`."""
    return lambda asked: Replied(encode(source(parse_course(asked.parameters))))


def parse_course(selected: str) -> CourseRequest:
    """The request of a selector's parameters.

    Raises ValueError naming parameter, value and what would be right.
    """
    parameters = parameters_of(selected, ("from", "to", "limit", *_ALSO))
    for name in _ALSO:
        if (wanted := parameters.get(name, "no")) not in ("yes", "no"):
            raise ValueError(f"{name} = {wanted!r}: expected yes or no")
    limit = limit_of(parameters, _MOST_ESTIMATES // 4, _MOST_ESTIMATES)
    return CourseRequest(*_span(parameters), limit, *(parameters.get(name) == "yes" for name in _ALSO))


def parse_selector(selected: str) -> HistoryRequest:
    """The request of a selector's parameters.

    Raises ValueError naming parameter, value and what would be right.
    """
    parameters = parameters_of(selected, _KNOWN)
    begin, end = _span(parameters)
    if (form := parameters.get("form", "rows")) not in ("rows", "blocks"):
        raise ValueError(f"form = {form!r}: expected rows or blocks")
    blocks, every_s = form == "blocks", _every_s(parameters)
    if blocks and every_s is not None:
        raise ValueError("form = 'blocks': gives only single readings; leave out every")
    limit = limit_of(parameters, *((_MOST_IN_BLOCKS,) * 2 if blocks else (MOST_ROWS // 5, MOST_ROWS)))
    channels = tuple(name for name in parameters.get("channels", "").split(",") if name)
    return HistoryRequest(begin, end, channels or None, limit, parameters.get("after"), every_s, blocks)


def _every_s(parameters: dict[str, str]) -> int | None:
    """Long intervals are whole minutes, of which the store has means: no query looks at a day of single readings."""
    if "every" not in parameters:
        return None
    text = parameters["every"]
    if text.isascii() and text.isdecimal() and len(text) <= len(str(_LONGEST_MINUTES_S)):
        every_s = int(text)
        if 1 <= every_s <= (_LONGEST_S if every_s % 60 else _LONGEST_MINUTES_S):
            return every_s
    raise ValueError(
        f"every = {text!r}: expected whole seconds, 1 to {_LONGEST_S}, or whole minutes of up to {_LONGEST_MINUTES_S} s"
    )


def _span(parameters: dict[str, str]) -> tuple[datetime, datetime]:
    begin, end = _time(parameters, "from"), _time(parameters, "to")
    if end <= begin:
        raise ValueError(f"to = {parameters['to']!r}: expected later than from = {parameters['from']!r}")
    return begin, end


def _time(parameters: dict[str, str], name: str) -> datetime:
    expected = "expected a time with its offset from UTC, such as 2026-03-02T06:00:00Z"
    if name not in parameters:
        raise ValueError(f"{name}: missing; {expected}")
    try:
        time = datetime.fromisoformat(parameters[name])
        if time.tzinfo is not None:
            return time.astimezone(UTC)
    except (ValueError, OverflowError):  # in UTC it may be before the year 1 or after 9999
        pass
    raise ValueError(f"{name} = {parameters[name]!r}: {expected}")
