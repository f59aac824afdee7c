"""Forwards what gateways publish to every outlet of a file, until a signal ends it."""

import logging
import threading
from datetime import UTC, datetime
from pathlib import Path
from time import monotonic

import click

from gateway.config.problems import ConfigError
from gateway.config.telemetry_rules import credential_problems
from gateway.listeners.outlets.outlet import OutletMessage
from gateway.listeners.outlets.settings import OutletFile, load_outlets
from gateway.listeners.outlets.source import GatewaySource
from gateway.runtime.signals import set_on_signals


def checked_outlets(path: Path) -> OutletFile:
    """The outlets of a file, each of which can be made. Raises ConfigError."""
    file = load_outlets(path)
    if wrong := list(credential_problems(file.source.telemetry, datetime.now(UTC))):
        raise ConfigError(path, wrong)
    file.feeds()
    return file


def forward(path: Path, file: OutletFile) -> None:
    """Forward until SIGINT or SIGTERM, and say at the end what was sent."""
    telemetry, feeds = file.source.telemetry, file.feeds()

    def take(heard: OutletMessage) -> None:
        now_s = monotonic()
        for feed in feeds:
            feed.put(heard, now_s)

    if logging.getLogger().level > logging.INFO:
        logging.getLogger("gateway").setLevel(logging.INFO)
    stop = threading.Event()
    threads = [threading.Thread(target=feed.run, name=feed.name, daemon=True) for feed in feeds]
    with GatewaySource(telemetry, file.source.machines, take):
        set_on_signals(stop)
        for thread in threads:
            thread.start()
        click.echo(f"{path}: forwarding what gateways at {', '.join(telemetry.connect)} publish")
        stop.wait()
    for feed in feeds:
        feed.stop()
    for thread, feed in zip(threads, feeds, strict=True):
        thread.join()
        click.echo(f"{feed.name}: {feed.account}")
