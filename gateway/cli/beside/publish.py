"""`talc-gateway publish`: forwards what gateways publish to other systems of the plant."""

import logging
import signal
import threading
from datetime import UTC, datetime
from pathlib import Path

import click

log = logging.getLogger(__name__)


@click.command()
@click.argument("outlets", type=click.Path(dir_okay=False, path_type=Path))
@click.option("--check", "only_check", is_flag=True, help="Check OUTLETS and end, without using the network.")
def publish(outlets: Path, only_check: bool) -> None:
    """Forward what gateways publish to the systems of OUTLETS, a TOML file: MQTT, InfluxDB (docs/outlets.md).

    \b
    It is a separate process, which only listens to the gateways, so that nothing here can delay or change a machine. A
    system that is away is tried again; meanwhile messages wait in memory, and the oldest are dropped when there are
    too many. It runs until SIGINT or SIGTERM, and says at the end what was sent.
    """
    from time import monotonic

    from gateway.config.problems import ConfigError
    from gateway.config.telemetry_rules import credential_problems
    from gateway.listeners.outlets.outlet import OutletMessage
    from gateway.listeners.outlets.settings import load_outlets
    from gateway.listeners.outlets.source import GatewaySource

    file = load_outlets(outlets)
    telemetry = file.source.telemetry
    if wrong := list(credential_problems(telemetry, datetime.now(UTC))):
        raise ConfigError(outlets, wrong)
    feeds = file.feeds()
    if only_check:
        names = ", ".join(f"{one.name} ({one.kind})" for one in file.outlets)
        click.echo(f"{outlets}: good. Outlets: {names}")
        return

    def take(heard: OutletMessage) -> None:
        now_s = monotonic()
        for feed in feeds:
            feed.put(heard, now_s)

    if logging.getLogger().level > logging.INFO:
        logging.getLogger("gateway").setLevel(logging.INFO)
    stop = threading.Event()
    threads = [threading.Thread(target=feed.run, name=feed.name, daemon=True) for feed in feeds]
    with GatewaySource(telemetry, file.source.machines, take):
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: stop.set())
        for thread in threads:
            thread.start()
        click.echo(f"{outlets}: forwarding what gateways at {', '.join(telemetry.connect)} publish")
        stop.wait()
    for feed in feeds:
        feed.stop()
    for thread, feed in zip(threads, feeds, strict=True):
        thread.join()
        click.echo(f"{feed.name}: {feed.account}")
