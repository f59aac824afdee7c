"""`talc-gateway watch`: an ordinary Zenoh subscriber that shows what a gateway publishes."""

import json
import logging
import signal
import threading
from collections.abc import Sequence

import click
import zenoh

from gateway.cli.view import LiveView, ViewState
from gateway.telemetry import decode, keys

log = logging.getLogger(__name__)

EXIT_WORLD = 3
_ANSWER_LIMIT_S = 5.0


def watch(connect: Sequence[str], prefix: str, machine: str) -> int:
    """Show a running gateway until SIGINT, SIGTERM or its end; returns the exit code (3: no gateway)."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps(list(connect)))
    config.insert_json5("scouting/multicast/enabled", "false")
    try:
        session = zenoh.open(config)
    except zenoh.ZError as error:
        log.info("%s", error)
        click.echo(f"error: no answer at {', '.join(connect)}. Is the gateway running?", err=True)
        return EXIT_WORLD
    with session:
        return _follow(session, keys.root(prefix, machine), machine)


def _follow(session: zenoh.Session, root: str, machine: str) -> int:
    state, lock, ended = ViewState(machine), threading.Lock(), threading.Event()

    def take(sample: zenoh.Sample) -> None:
        suffix = str(sample.key_expr).removeprefix(root + "/")
        try:
            message = decode(suffix, sample.payload.to_bytes())
        except ValueError as error:
            log.warning("%s", error)
            return
        if message is not None:
            with lock:
                state.apply(message)

    def life(sample: zenoh.Sample) -> None:
        if sample.kind == zenoh.SampleKind.DELETE:
            state.alive = False
            ended.set()

    alive = f"{root}/{keys.ALIVE}"
    if not list(session.liveliness().get(alive, timeout=_ANSWER_LIMIT_S)):
        click.echo(f"error: no running gateway found under {root}", err=True)
        return EXIT_WORLD
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())
    watcher = session.liveliness().declare_subscriber(alive, life)
    subscriber = session.declare_subscriber(f"{root}/**", take)
    for reply in session.get(f"{root}/**", timeout=_ANSWER_LIMIT_S):
        if reply.ok is not None:
            take(reply.ok)
    try:
        with LiveView(state):
            while not ended.wait(0.5):
                pass
    finally:
        subscriber.undeclare()
        watcher.undeclare()
    if not state.alive:
        click.echo(f"{machine}: the gateway has ended")
    return 0
