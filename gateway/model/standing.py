"""The states of a wanted measurement, for programs that only read messages."""

from enum import StrEnum


class Standing(StrEnum):
    """State of a wanted measurement."""

    NOT_WANTED = "not_wanted"
    WAITING = "waiting"
    BLOCKED = "blocked"
    DUE = "due"
    ASKED = "asked"
