"""The key space: what is published under which key. Keys are `<prefix>/<machine>/<kind>[/<name>]`."""

import re
from typing import Final

from gateway.config.fields import NAME_FORM

VERSION: Final = 1
"""Version of the key space. Keys and fields are only ever added to it; what would break a reader makes another
version."""

READING: Final = "reading"
FRAME: Final = "frame"
DECISION: Final = "decision"
MEASUREMENT: Final = "measurement"
MODEL: Final = "model"
EVENT: Final = "event"
COMPENSATION: Final = "compensation"
PROBING: Final = "probing"
SENSORS: Final = "sensors"
REASONS: Final = "reasons"
FORECAST: Final = "forecast"
STATUS: Final = "status"
ALIVE: Final = "alive"
"""A liveliness token; nothing is published under it."""

SCHEMA: Final = "schema"
"""A query on `schema/<kind>` is answered with the JSON Schema of that kind; nothing is published under it."""
COURSE: Final = "course"
"""A query on it is answered with stored estimates and measurements; nothing is published under it."""
HISTORY: Final = "history"
"""A query on it is answered with stored readings; nothing is published under it."""
REPORT: Final = "report"
"""A query on it is answered with the report of a day; nothing is published under it."""
SCENARIO: Final = "scenario"
"""A query on it is answered with a forecast under a load that runs for some minutes; nothing is published under it."""
STORED: Final = "stored"
"""A query on it is answered with the rows that follow a position in each table; nothing is published under it."""

COMMAND: Final = "command"
"""A query on it is answered with a challenge, one on `command/<name>` is a command; nothing is published under it."""


MACHINE: Final = re.compile(NAME_FORM)
"""Name of a machine: nothing in it means something in a key or in a path."""


def root(prefix: str, machine: str) -> str:
    """The key with which all of a gateway's keys begin."""
    return f"{prefix}/{machine}"


def kind_of(suffix: str) -> str:
    """The kind of a key below the root: its first part."""
    return suffix.partition("/")[0]


def asks_for(kind: str, key_expression: str) -> bool:
    """Whether a query names this kind itself: a query of wildcards asks only for last values, not for all that can be
    had."""
    return kind in key_expression.split("/")
