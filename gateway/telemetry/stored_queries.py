"""Queries on `stored`: the rows that follow a position in each table of the database, for collectors."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from gateway.telemetry.answers import StoredRows
from gateway.telemetry.codec import encode
from gateway.telemetry.queries import MOST_ROWS, Answering, Replied, limit_of, parameters_of

_KNOWN = ("after", "limit")
_AFTER = re.compile(r"(?P<table>[a-z]{1,40})(?::(?P<epoch>[0-9a-f]{32}):(?P<number>-?[0-9]{1,19}))?")
_LARGEST = 2**63 - 1
"""Largest integer of SQLite."""


@dataclass(frozen=True, slots=True)
class StoredRequest:
    """What a query on `stored` asks for."""

    after: Mapping[str, tuple[str, int] | None]
    """By table: the epoch, and the number of the last row that the asker has; None: from the beginning."""
    limit: int
    """Rows of a table."""


StoredSource = Callable[[StoredRequest], StoredRows]
"""Finds rows. Raises ValueError when the request is wrong, OSError when there is nothing to read from."""


def stored_answer(source: StoredSource) -> Answering:
    """What answers queries with rows of this source."""
    return lambda asked: Replied(encode(source(parse_stored(asked.parameters))))


def parse_stored(selected: str) -> StoredRequest:
    """The request of a selector's parameters.

    Raises ValueError naming parameter, value and what would be right.
    """
    parameters = parameters_of(selected, _KNOWN)
    after: dict[str, tuple[str, int] | None] = {}
    for text in parameters.get("after", "").split(","):
        found = _AFTER.fullmatch(text)
        if found is None or found["table"] in after:
            raise ValueError(f"after = {text!r}: expected different tables, as TABLE or TABLE:EPOCH:NUMBER")
        if found["epoch"] is None:
            after[found["table"]] = None
        else:
            number = int(found["number"])
            if abs(number) > _LARGEST:
                raise ValueError(f"after = {text!r}: expected a number of a row")
            after[found["table"]] = (found["epoch"], number)
    return StoredRequest(after, limit_of(parameters, MOST_ROWS // 5, MOST_ROWS))
