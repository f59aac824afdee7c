"""A site's gateways, as a collector reaches them over Zenoh."""

from collections.abc import Mapping
from contextlib import ExitStack
from types import TracebackType
from typing import Self

import zenoh

from gateway.config.telemetry import Telemetry
from gateway.listeners.collect.progress import TablePlace
from gateway.telemetry import keys
from gateway.telemetry.answers import StoredRows
from gateway.telemetry.asking import ask_only, running
from gateway.telemetry.session import TelemetryError, page_config, reading_session


class SiteNetwork:
    """All gateways that are heard, as a context manager. It only asks.

    Parameters
    ----------
    telemetry: where to connect and how, and the prefix of the keys
    answer_limit_s: how long an answer is waited for, s

    Raises TelemetryError or OSError on entry.
    """

    def __init__(self, telemetry: Telemetry, answer_limit_s: float = 10.0) -> None:
        self._telemetry, self._limit_s = telemetry, answer_limit_s
        self._session: zenoh.Session | None = None
        self._leaving = ExitStack()

    def __enter__(self) -> Self:
        opening = reading_session(page_config(self._telemetry), lambda why: TelemetryError(f"no Zenoh session: {why}"))
        self._session = self._leaving.enter_context(opening)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._leaving.close()

    @property
    def _open(self) -> zenoh.Session:
        if self._session is None:
            raise RuntimeError("used outside of its `with`")
        return self._session

    def running(self) -> list[str]:
        """The machines whose gateways run now."""
        return running(self._open, self._telemetry.prefix, self._limit_s)

    def ask(self, machine: str, after: Mapping[str, TablePlace | None], limit: int) -> StoredRows:
        """The rows of a gateway that follow these places. Raises OSError when it does not answer, or says why not;
        ValueError for an invalid answer."""
        places = ",".join(
            table if place is None else f"{table}:{place[0]}:{place[1]}" for table, place in after.items()
        )
        key = f"{keys.root(self._telemetry.prefix, machine)}/{keys.STORED}"
        return ask_only(self._open, f"{key}?after={places};limit={limit}", StoredRows, self._limit_s)
