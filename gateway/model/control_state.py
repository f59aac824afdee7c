"""The state of the control, as the health and the published status give it."""

from enum import StrEnum


class NcState(StrEnum):
    """The state of the control, as the health and the published status give it."""

    NONE = "none"
    """No control is configured."""
    AWAY = "away"
    """It cannot be reached."""
    STALE = "stale"
    """It answers, but its axes report a speed and do not move."""
    NOT_READY = "not_ready"
    """Emergency stop, drives off or axes not referenced."""
    PROBING = "probing"
    READY = "ready"
