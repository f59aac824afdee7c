"""Everything that is heard of the machines of a site: a Zenoh subscriber that publishes nothing."""

import logging
import re
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from time import monotonic
from typing import Self

import zenoh

from gateway.config import Telemetry
from gateway.telemetry import TelemetryError, decode, keys, page_config, without_path
from gateway.web.seen import MachineSeen

log = logging.getLogger(__name__)

_MACHINE = re.compile(r"[A-Za-z0-9_-]{1,100}")
_MOST_MACHINES = 100
_ANSWER_LIMIT_S = 5.0


def listened_to(telemetry: Telemetry) -> tuple[str, ...]:
    """The endpoints at which what this gateway publishes is heard on its own computer."""
    return (*(place.from_here for place in telemetry.listening), *telemetry.connect)


class SiteSeen:
    """The machines under one prefix. Zenoh calls from threads of its own; `machines` holds them off.

    Parameters
    ----------
    prefix: first part of every key
    expected: machines that are shown even before anything is heard of them
    now: this computer's UTC
    now_s: this computer's monotonic seconds
    """

    def __init__(
        self,
        prefix: str,
        expected: Iterable[str] = (),
        now: Callable[[], datetime] = lambda: datetime.now(UTC),
        now_s: Callable[[], float] = monotonic,
    ) -> None:
        self.prefix, self._now, self.now_s = prefix, now, now_s
        self._lock = threading.Lock()
        self._machines = {name: MachineSeen(name) for name in expected}
        self.changed: Callable[[], None] = lambda: None
        """Called from any thread when something was heard."""

    @contextmanager
    def machines(self) -> Iterator[dict[str, MachineSeen]]:
        """By name; nothing changes meanwhile."""
        with self._lock:
            yield self._machines

    def may_be(self, machine: str) -> bool:
        """Whether there is a machine of this name, or one could be heard of later."""
        return machine in self._machines or _MACHINE.fullmatch(machine) is not None

    def take(self, key: str, payload: bytes) -> None:
        """One published message; an invalid one is only logged."""
        machine, _, suffix = key.removeprefix(self.prefix + "/").partition("/")
        try:
            message = decode(suffix, payload)
        except ValueError as error:
            log.warning("%s: %s", machine, error)
            return
        if message is not None:
            with self._lock:
                if (seen := self._of(machine)) is not None:
                    seen.apply(suffix, message, self._now(), self.now_s())
            self.changed()

    def life(self, key: str, *, alive: bool) -> None:
        """A liveliness token has appeared or disappeared."""
        machine = key.removeprefix(self.prefix + "/").partition("/")[0]
        with self._lock:
            if (seen := self._of(machine)) is not None:
                seen.appear(self._now()) if alive else seen.disappear(self._now())
        self.changed()

    def _of(self, machine: str) -> MachineSeen | None:
        if machine not in self._machines and _MACHINE.fullmatch(machine) and len(self._machines) < _MOST_MACHINES:
            self._machines[machine] = MachineSeen(machine)
        return self._machines.get(machine)


class SiteSubscription:
    """Feeds a site from Zenoh while it is entered; absent gateways are tried again without end.

    Parameters
    ----------
    site: what takes in the messages
    settings: where to connect to; see `page_config`

    Raises TelemetryError on entry.
    """

    def __init__(self, site: SiteSeen, settings: Telemetry) -> None:
        self._site, self._settings = site, settings
        self._session: zenoh.Session | None = None

    def __enter__(self) -> Self:
        where = ", ".join(self._settings.connect)
        try:
            self._session = zenoh.open(page_config(self._settings))
        except zenoh.ZError as error:
            raise TelemetryError(f"no Zenoh session to {where}: {without_path(error)}") from error
        root = keys.root(self._site.prefix, "*")
        self._subscriber = self._session.declare_subscriber(f"{root}/**", self._heard)
        token = f"{root}/{keys.ALIVE}"
        self._watcher = self._session.liveliness().declare_subscriber(token, self._life, history=True)
        return self

    def __exit__(self, *_: object) -> None:
        if self._session is not None:
            self._watcher.undeclare()
            self._subscriber.undeclare()
            self._session.close()

    def _heard(self, sample: zenoh.Sample) -> None:
        self._site.take(str(sample.key_expr), sample.payload.to_bytes())

    def _life(self, sample: zenoh.Sample) -> None:
        key, alive = str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT
        self._site.life(key, alive=alive)
        if alive and self._session is not None:
            machine = key.removesuffix(f"/{keys.ALIVE}")
            self._session.get(f"{machine}/**", self._answered, timeout=_ANSWER_LIMIT_S)

    def _answered(self, reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            self._heard(reply.ok)
