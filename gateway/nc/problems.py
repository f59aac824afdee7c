"""Lasting problems of the control: the text that reports each one, and the text that ends it."""

from collections.abc import Iterable

NOT_CONNECTED, CONNECTED_AGAIN = "NC: not connected: ", "NC: connected again"
NOT_RECEIVED = "NC: its watchdog did not receive the heartbeat of this gateway"
NOT_ANSWERED = "NC: its watchdog does not answer the heartbeats"
UNRECEIVED = (
    f"{NOT_RECEIVED}: nothing is written until it does, and what is in force may stay. Look at the network, and "
    "whether TALC's program still runs on the control"
)
HEARD_AGAIN = "NC: its watchdog is active again"
DISARMED = "compensation is disarmed until a restart"
_BEGINNINGS = {CONNECTED_AGAIN: (NOT_CONNECTED,), HEARD_AGAIN: (NOT_RECEIVED, NOT_ANSWERED)}
"""By the text that ends it."""


def still_wrong(texts: Iterable[str]) -> tuple[str, ...]:
    """What is still wrong with the control, by all texts that one run has reported."""
    found: dict[str, str] = {}
    for text in texts:
        if text.startswith("NC: ") and DISARMED in text:
            found[DISARMED] = text
        for end, beginnings in _BEGINNINGS.items():
            if text.startswith(beginnings):
                found[end] = text
            elif text == end:
                found.pop(end, None)
    return tuple(found.values())
