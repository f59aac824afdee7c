"""Follows one gateway as an ordinary Zenoh subscriber, and shows what it publishes."""

import logging
import threading
from collections.abc import Sequence
from time import monotonic
from typing import Any

import click
import msgspec
import zenoh

from gateway.config.model import GatewayConfig
from gateway.listeners.watch.view import LiveView, ViewState
from gateway.model.codes import NoticeCode
from gateway.model.text import Language, Text
from gateway.runtime.signals import set_on_signals
from gateway.runtime.terminal import printable
from gateway.telemetry import keys
from gateway.telemetry.client import ANSWER_LIMIT_S, Machine, MachineError
from gateway.telemetry.codec import decode
from gateway.telemetry.session import Access, own_access
from gateway.telemetry.subscriber.runs import HeardRuns

log = logging.getLogger(__name__)


def watch(connect: Sequence[str], prefix: str, machine: str | None, access: Access, language: str = "en") -> bool:
    """Show a running gateway until SIGINT, SIGTERM or its end; False if there is no gateway.

    machine: None: the only one that runs there. Raises click.BadParameter.
    """
    try:
        followed = Machine(machine, connect=connect, prefix=prefix, access=access)
    except ValueError as error:
        raise click.BadParameter(str(error)) from None
    try:
        with followed:
            return _follow(followed.session, followed.root, followed.name, language)
    except MachineError as error:
        click.echo(f"error: {error}", err=True)
        return False


def watch_own(config: GatewayConfig, language: str = "en") -> bool:
    """Show the gateway of this configuration, which runs on this computer or publishes to the same router."""
    telemetry = config.telemetry
    places = [place.from_here for place in telemetry.listening] or list(telemetry.connect)
    if not (telemetry.enabled and places):
        raise click.UsageError("[telemetry] of this configuration has no endpoint at which a gateway could be reached")
    try:
        access = own_access(telemetry)
    except OSError as error:
        click.echo(f"error: {error.filename} cannot be read: {error.strerror}", err=True)
        return False
    return watch(places, telemetry.prefix, config.machine.name, access, language)


def _printable(value: Any) -> Any:
    """Texts of other programs without escape sequences."""
    match value:
        case str():
            return printable(value)
        case dict():
            return {_printable(key): _printable(item) for key, item in value.items()}
        case list() | tuple():
            return [_printable(item) for item in value]
        case _:
            return value


class _Followed:
    """One gateway as its messages show it. Zenoh calls `take` and `life` from its own threads."""

    def __init__(self, machine: str, root: str) -> None:
        self.state, self.ended = ViewState(machine), threading.Event()
        self._root, self._lock = root, threading.Lock()
        self._runs, self._told = HeardRuns(log), False

    def take(self, sample: zenoh.Sample) -> None:
        """Show a message; an invalid one is only logged."""
        suffix = str(sample.key_expr).removeprefix(self._root + "/")
        try:
            message = decode(suffix, sample.payload.to_bytes())
        except ValueError as error:
            log.warning("%s", error)
            return
        if message is not None:
            now_s = monotonic()
            follows = self._runs.follows(self.state.machine, message.boot, now_s)
            if self._runs.two(self.state.machine, now_s) and not self._told:
                self._told = True
                other = Text(NoticeCode.TWO_OF_ONE_NAME, machine=self.state.machine, other=message.boot)
                with self._lock:
                    self.state.warn(other)
            if not follows:
                return
            shown = msgspec.convert(_printable(msgspec.to_builtins(message)), type(message))
            with self._lock:
                self.state.apply(shown)

    def life(self, sample: zenoh.Sample) -> None:
        """The gateway has begun or ended."""
        if sample.kind == zenoh.SampleKind.DELETE:
            self.state.alive = False
            self.ended.set()


def _follow(session: zenoh.Session, root: str, machine: str, language: str) -> bool:
    followed, alive = _Followed(machine, root), f"{root}/{keys.ALIVE}"
    set_on_signals(followed.ended)
    watcher = session.liveliness().declare_subscriber(alive, followed.life)
    subscriber = session.declare_subscriber(f"{root}/**", followed.take)
    for reply in session.get(f"{root}/**", timeout=ANSWER_LIMIT_S):
        if reply.ok is not None:
            followed.take(reply.ok)
    try:
        with LiveView(followed.state, summary_at_once=True, language=language):
            while not followed.ended.wait(0.5):
                pass
    finally:
        subscriber.undeclare()
        watcher.undeclare()
    if not followed.state.alive:
        click.echo(Language(language)("watch.ended", machine=machine))
    return True
