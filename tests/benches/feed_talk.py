"""Messages as outlets get them, and outlets that a test makes fail."""

import json
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

from gateway.listeners.outlets.outlet import OutletError, OutletMessage
from gateway.telemetry.codec import decode
from tests.benches.played_telemetry import recorded


@cache
def _last(kind: str) -> Mapping[str, Any]:
    """The last message of a kind that a gateway once published."""
    return next(message for key, message in reversed(recorded()) if key.partition("/")[0] == kind)


def heard(suffix: str, machine: str = "mill", **changes: Any) -> OutletMessage:
    """The last message of a kind that a gateway once published, with other fields."""
    payload = json.dumps({**_last(suffix.partition("/")[0]), **changes}).encode()
    return OutletMessage(machine, suffix, decode(suffix, payload), payload)


def reading(number: int, **changes: Any) -> OutletMessage:
    """The reading with this number."""
    return heard("reading/bed_front", channel="bed_front", unit="degC", seq=number, value=float(number), **changes)


class FailingOutlet:
    """Keeps what is sent, unless a test makes it fail."""

    def __init__(self) -> None:
        self.sent: list[list[OutletMessage]] = []
        self.opened = 0
        self.is_open = False
        self.away: OutletError | None = None
        self.failing: BaseException | None = None

    def open(self) -> None:
        if self.away is not None:
            raise self.away
        self.opened, self.is_open = self.opened + 1, True

    def send(self, batch: Sequence[OutletMessage]) -> None:
        if self.failing is not None:
            raise self.failing
        self.sent.append(list(batch))

    def close(self) -> None:
        self.is_open = False
