"""`talc-gateway watch`: an ordinary Zenoh subscriber that shows what a gateway publishes."""

import json
import logging
import re
import signal
import threading
from collections.abc import Sequence
from typing import Any

import click
import msgspec
import zenoh

from gateway.cli.exits import EXIT_WORLD
from gateway.cli.terminal import printable
from gateway.cli.view import LiveView, ViewState
from gateway.telemetry import decode, keys

log = logging.getLogger(__name__)

_ANSWER_LIMIT_S = 5.0
_NAME = re.compile(r"[A-Za-z0-9_-]+(/[A-Za-z0-9_-]+)*")
"""Of a prefix or a machine: no wildcard, and nothing that a key may not contain."""


def watch(connect: Sequence[str], prefix: str, machine: str | None) -> int:
    """Show a running gateway until SIGINT, SIGTERM or its end; returns the exit code (3: no gateway).

    machine: None: the only one that runs there. Raises click.BadParameter.
    """
    for name, value in (("--prefix", prefix), ("--machine", machine)):
        if value is not None and not _NAME.fullmatch(value):
            expected = "expected letters, digits, _ and -"
            raise click.BadParameter(f"{value!r}: {expected}", param_hint=name)
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("scouting/multicast/enabled", "false")
    try:
        config.insert_json5("connect/endpoints", json.dumps(list(connect)))
    except zenoh.ZError:
        expected = "expected Zenoh endpoints such as tcp/192.168.1.5:7447"
        raise click.BadParameter(f"{', '.join(connect)!r}: {expected}", param_hint="--connect") from None
    try:
        session = zenoh.open(config)
    except zenoh.ZError as error:
        log.info("%s", error)
        click.echo(f"error: no answer at {', '.join(connect)}. Is the gateway running?", err=True)
        return EXIT_WORLD
    with session:
        alive = _alive(session, prefix)
        chosen = alive[0] if machine is None and len(alive) == 1 else machine
        if chosen is None or chosen not in alive:
            click.echo(f"error: {_not_found(prefix, machine, alive)}", err=True)
            return EXIT_WORLD
        return _follow(session, keys.root(prefix, chosen), chosen)


def _alive(session: zenoh.Session, prefix: str) -> list[str]:
    """The machines whose gateways run now."""
    replies = session.liveliness().get(f"{keys.root(prefix, '*')}/{keys.ALIVE}", timeout=_ANSWER_LIMIT_S)
    found = {str(reply.ok.key_expr).split("/")[-2] for reply in replies if reply.ok is not None}
    return sorted(name for name in found if _NAME.fullmatch(name))


def _not_found(prefix: str, machine: str | None, alive: Sequence[str]) -> str:
    if not alive:
        return f"no gateway runs under {prefix}; --prefix is [telemetry] prefix of its configuration"
    running = f"running: {', '.join(alive)}"
    if machine is None:
        return f"several gateways run under {prefix}; choose one with --machine; {running}"
    return f"no gateway of machine {machine} runs under {prefix}; {running}"


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
    """One gateway as its messages show it. Zenoh calls `take` and `life` from threads of its own."""

    def __init__(self, machine: str, root: str) -> None:
        self.state, self.ended = ViewState(machine), threading.Event()
        self._root, self._lock = root, threading.Lock()

    def take(self, sample: zenoh.Sample) -> None:
        """Show a message; an invalid one is only logged."""
        suffix = str(sample.key_expr).removeprefix(self._root + "/")
        try:
            message = decode(suffix, sample.payload.to_bytes())
        except ValueError as error:
            log.warning("%s", error)
            return
        if message is not None:
            shown = msgspec.convert(_printable(msgspec.to_builtins(message)), type(message))
            with self._lock:
                self.state.apply(shown)

    def life(self, sample: zenoh.Sample) -> None:
        """The gateway has begun or ended."""
        if sample.kind == zenoh.SampleKind.DELETE:
            self.state.alive = False
            self.ended.set()


def _follow(session: zenoh.Session, root: str, machine: str) -> int:
    followed, alive = _Followed(machine, root), f"{root}/{keys.ALIVE}"
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: followed.ended.set())
    watcher = session.liveliness().declare_subscriber(alive, followed.life)
    subscriber = session.declare_subscriber(f"{root}/**", followed.take)
    for reply in session.get(f"{root}/**", timeout=_ANSWER_LIMIT_S):
        if reply.ok is not None:
            followed.take(reply.ok)
    try:
        with LiveView(followed.state, summary_at_once=True):
            while not followed.ended.wait(0.5):
                pass
    finally:
        subscriber.undeclare()
        watcher.undeclare()
    if not followed.state.alive:
        click.echo(f"{machine}: the gateway has ended")
    return 0
