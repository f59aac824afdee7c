"""One Zenoh session that hears every gateway below a prefix, and asks each that appears for what it has published."""

from collections.abc import Callable
from contextlib import ExitStack
from typing import Self

import zenoh

from gateway.config.telemetry import Telemetry
from gateway.telemetry import keys
from gateway.telemetry.session import TelemetryError, page_config, reading_session

_ANSWER_LIMIT_S = 10.0


class Hearing:
    """Hears while it is entered; gateways that are absent are tried again without end. It publishes nothing.

    Both functions are called from Zenoh's threads, with whole keys, and must return at once.

    Parameters
    ----------
    telemetry: where to connect and how, and the prefix of the keys
    heard: takes a message, or the answer to a query, which may be older than what was heard before
    life: takes a liveliness token that has appeared or disappeared; returns whether its machine is of interest

    Raises TelemetryError on entry.
    """

    def __init__(
        self, telemetry: Telemetry, heard: Callable[[str, bytes], None], life: Callable[[str, bool], bool]
    ) -> None:
        self._telemetry, self._heard, self._life = telemetry, heard, life
        self._session: zenoh.Session | None = None
        self._leaving = ExitStack()

    def __enter__(self) -> Self:
        where = ", ".join(self._telemetry.connect)

        def refused(why: str) -> TelemetryError:
            return TelemetryError(f"no Zenoh session to {where}: {why}")

        root = keys.root(self._telemetry.prefix, "*")
        with ExitStack() as stack:
            session = stack.enter_context(reading_session(page_config(self._telemetry), refused))
            self._session = session
            stack.callback(session.declare_subscriber(f"{root}/**", self._take).undeclare)
            token = f"{root}/{keys.ALIVE}"
            watcher = session.liveliness().declare_subscriber(token, self._appeared, history=True)
            stack.callback(watcher.undeclare)
            self._leaving = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._leaving.close()

    @property
    def session(self) -> zenoh.Session:
        """For questions. Raises OSError before it is entered."""
        if self._session is None:
            raise OSError("not connected")
        return self._session

    def _take(self, sample: zenoh.Sample) -> None:
        self._heard(str(sample.key_expr), sample.payload.to_bytes())

    def _appeared(self, sample: zenoh.Sample) -> None:
        key, alive = str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT
        if self._life(key, alive) and alive and self._session is not None:  # what it published before it was heard
            machine = key.removesuffix(f"/{keys.ALIVE}")
            self._session.get(f"{machine}/**", self._answered, timeout=_ANSWER_LIMIT_S)

    def _answered(self, reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            self._take(reply.ok)
