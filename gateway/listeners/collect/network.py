"""A site's gateways, as a collector reaches them over Zenoh."""

from collections.abc import Mapping
from types import TracebackType
from typing import Self

import zenoh

from gateway.config.telemetry import Telemetry
from gateway.listeners.collect.progress import TablePlace
from gateway.telemetry import keys
from gateway.telemetry.answers import StoredRows
from gateway.telemetry.asking import ask_only, running
from gateway.telemetry.subscriber.sessions import PlaceSessions


class SiteNetwork:
    """All gateways that are heard, as a context manager. It only asks; places that are away are tried again.

    Parameters
    ----------
    telemetry: where to connect and how, and the prefix of the keys
    answer_limit_s: how long an answer is waited for, s
    """

    def __init__(self, telemetry: Telemetry, answer_limit_s: float = 10.0) -> None:
        self._telemetry, self._limit_s = telemetry, answer_limit_s
        self._sessions = PlaceSessions(telemetry)
        self._at: dict[str, list[zenoh.Session]] = {}
        """By machine: where its gateway was found running."""

    def __enter__(self) -> Self:
        self._sessions.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._sessions.__exit__()

    def running(self) -> list[str]:
        """The machines whose gateways run now."""
        found: dict[str, list[zenoh.Session]] = {}
        for session in self._sessions.open:
            for machine in running(session, self._telemetry.prefix, self._limit_s):
                found.setdefault(machine, []).append(session)
        self._at = found
        return sorted(found)

    def ask(self, machine: str, after: Mapping[str, TablePlace | None], limit: int) -> StoredRows:
        """The rows of a gateway that follow these places. Raises OSError when it does not answer, or says why not;
        ValueError for an invalid answer."""
        places = ",".join(
            table if place is None else f"{table}:{place[0]}:{place[1]}" for table, place in after.items()
        )
        key = f"{keys.root(self._telemetry.prefix, machine)}/{keys.STORED}"
        at = self._at.get(machine) or self._sessions.open
        return ask_only(at, f"{key}?after={places};limit={limit}", StoredRows, self._limit_s)
