"""The source of the outlets: every message that gateways publish over Zenoh, once, and which gateways run."""

import logging
import re
from collections.abc import Callable, Collection
from time import monotonic
from typing import Self

from gateway.config.telemetry import Telemetry
from gateway.listeners.outlets.outlet import OutletMessage
from gateway.telemetry.codec import decode
from gateway.telemetry.subscriber.hearing import Hearing
from gateway.telemetry.subscriber.runs import HeardRuns
from gateway.telemetry.subscriber.unreadable import UnreadableMessages

log = logging.getLogger(__name__)

_MOST_KEYS = 100_000
_KEY = re.compile(r"[A-Za-z0-9_-]{1,100}/[A-Za-z0-9_/-]{1,200}")
"""Machine and key below it, as gateways publish them; what others put beside them is not passed on."""


class GatewaySource:
    """Hears all gateways while it is entered; those that are absent are tried again without end. It only reads.

    Parameters
    ----------
    telemetry: where to connect and how, and the prefix of the keys
    machines: those that are passed on; empty: all
    take: receives what was heard, from Zenoh's threads; must return at once
    """

    def __init__(self, telemetry: Telemetry, machines: Collection[str], take: Callable[[OutletMessage], None]) -> None:
        self._prefix, self._machines, self._take = telemetry.prefix, frozenset(machines), take
        self._hearing = Hearing(telemetry, self._heard, self._life)
        self._passed: dict[str, tuple[str, int]] = {}
        """Boot and number of the latest message, by key."""
        self._runs = HeardRuns(log)
        self._unreadable = UnreadableMessages(log, "not passed on")

    def __enter__(self) -> Self:
        self._hearing.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self._hearing.__exit__()

    def _place(self, key: str) -> tuple[str, str]:
        """Machine and key below it."""
        machine, _, suffix = key.removeprefix(self._prefix + "/").partition("/")
        return machine, suffix

    def _is_wanted(self, machine: str, suffix: str) -> bool:
        known = not self._machines or machine in self._machines
        return known and _KEY.fullmatch(f"{machine}/{suffix}") is not None

    def _heard(self, whole: str, payload: bytes) -> None:
        machine, suffix = self._place(whole)
        if not self._is_wanted(machine, suffix):
            return
        key = f"{machine}/{suffix}"
        try:
            message = decode(suffix, payload)
        except ValueError as error:
            self._unreadable.invalid(machine, suffix, error)
            return
        if message is None:
            return
        self._unreadable.valid(machine, suffix)
        if not self._runs.follows(machine, message.boot, monotonic()):
            return  # of another gateway of this name
        boot, number = self._passed.get(key, ("", -1))
        if message.boot == boot and message.seq <= number:
            return  # the answer to a query, and older than what was heard
        if key in self._passed or len(self._passed) < _MOST_KEYS:
            self._passed[key] = message.boot, message.seq
            self._take(OutletMessage(machine, suffix, message, payload))

    def _life(self, key: str, alive: bool) -> bool:
        machine, suffix = self._place(key)
        wanted = self._is_wanted(machine, suffix)
        if wanted:
            self._take(OutletMessage(machine, suffix, None, alive=alive))
        return wanted
