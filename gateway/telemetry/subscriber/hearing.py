"""Hears every gateway below a prefix, and asks each that appears for what it has published."""

import threading
from collections.abc import Callable, Sequence
from functools import partial
from typing import Self

import zenoh

from gateway.config.telemetry import Telemetry
from gateway.telemetry import keys
from gateway.telemetry.subscriber.sessions import PlaceSessions

_ANSWER_LIMIT_S = 10.0


class Hearing:
    """Hears while it is entered; places that are absent are tried again without end. It publishes nothing.

    Both functions are called from Zenoh's threads, with whole keys, and must return at once. What is heard at two
    places is passed on twice, with the same run and number.

    Parameters
    ----------
    telemetry: where to connect and how, and the prefix of the keys
    heard: takes a message, or the answer to a query, which may be older than what was heard before
    life: takes a liveliness token that has appeared, or has disappeared everywhere; returns whether its machine is of
        interest
    """

    def __init__(
        self, telemetry: Telemetry, heard: Callable[[str, bytes], None], life: Callable[[str, bool], bool]
    ) -> None:
        self._prefix, self._heard, self._life = telemetry.prefix, heard, life
        self._lock = threading.Lock()
        self._alive: dict[str, list[zenoh.Session]] = {}
        """By key of the token: where it is seen."""
        self._declared: list[object] = []
        """What is heard as long as it is kept."""
        self._sessions = PlaceSessions(telemetry, self._opened)

    def __enter__(self) -> Self:
        self._sessions.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self._sessions.__exit__()

    def at(self, machine: str) -> Sequence[zenoh.Session]:
        """The sessions in which a machine can be asked. Raises OSError when there is none."""
        with self._lock:
            found = self._alive.get(f"{keys.root(self._prefix, machine)}/{keys.ALIVE}") or self._sessions.open
        if not found:
            raise OSError("; ".join(self._sessions.problems) or "not connected")
        return list(found)

    def _opened(self, session: zenoh.Session) -> None:
        root = keys.root(self._prefix, "*")
        self._declared.append(session.declare_subscriber(f"{root}/**", self._take))
        life = partial(self._lives, session)
        token = f"{root}/{keys.ALIVE}"
        self._declared.append(session.liveliness().declare_subscriber(token, life, history=True))

    def _take(self, sample: zenoh.Sample) -> None:
        self._heard(str(sample.key_expr), sample.payload.to_bytes())

    def _lives(self, session: zenoh.Session, sample: zenoh.Sample) -> None:
        key, alive = str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT
        with self._lock:
            places = self._alive.setdefault(key, [])
            if session in places:
                places.remove(session)
            if alive:
                places.append(session)
            elif places:
                return  # it is still seen elsewhere
        if self._life(key, alive) and alive:  # what it published before it was heard
            machine = key.removesuffix(f"/{keys.ALIVE}")
            session.get(f"{machine}/**", self._answered, timeout=_ANSWER_LIMIT_S)

    def _answered(self, reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            self._take(reply.ok)
