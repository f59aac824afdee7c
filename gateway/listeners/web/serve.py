"""`talc-gateway web`: serves the page for operators. It only listens, and passes on the commands of [operators]."""

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click
import uvicorn

from drivers.section import host_and_port
from gateway.listeners.web.access import check_certificate, check_listening
from gateway.listeners.web.app import build_app
from gateway.listeners.web.settings import MachineUse, load_settings
from gateway.runtime.garbage import freeze_gc
from gateway.runtime.listening import ACCEPTED_AT_ONCE, GuardedSocket
from gateway.telemetry.subscriber.places import heard_at
from gateway.telemetry.subscriber.site import SiteSeen, SiteSubscription

if TYPE_CHECKING:
    from gateway.config.model import GatewayConfig

_GOODBYE_S = 2
"""Streams never end by themselves: open pages are cut after this time when the page stops."""


@dataclass(frozen=True, slots=True)
class WebCommand:
    """What to serve."""

    config: "GatewayConfig | None"
    """Configuration of a gateway on this computer; None: only what `connect` says."""
    connect: tuple[str, ...]
    prefix: str | None
    settings: Path | None
    host: str
    port: int


def serve_pages(command: WebCommand) -> None:
    """Serve until SIGINT or SIGTERM. Raises ConfigError, SetupError, OSError."""
    settings = load_settings(command.settings)
    check_listening(command.host, settings)
    if settings.tls is not None:
        check_certificate(settings.tls)
    telemetry = heard_at(command.config, command.connect, command.prefix)
    expected: Sequence[str] = tuple(settings.machines)
    uses: dict[str, MachineUse] = {}
    if command.config is not None:
        name, probing = command.config.machine.name, command.config.probing
        expected = (name, *expected)
        uses[name] = MachineUse(sphere_radius_mm=probing.sphere_radius_mm, sphere_height_mm=probing.sphere_height_mm)
    site = SiteSeen(telemetry.prefix, expected)
    with closing(_listening(command.host, command.port)) as listening:
        app = build_app(site, settings, SiteSubscription(site, telemetry), uses, known=listening.know)
        tls = settings.tls
        server = uvicorn.Server(
            uvicorn.Config(
                app,
                log_level="error",  # each request that is none would be a line
                access_log=False,
                server_header=False,
                proxy_headers=False,
                backlog=ACCEPTED_AT_ONCE,
                timeout_graceful_shutdown=_GOODBYE_S,
                ssl_certfile=None if tls is None else str(tls.certificate),
                ssl_keyfile=None if tls is None else str(tls.key),
            )
        )
        click.echo(f"{'http' if tls is None else 'https'}://{listening.address}/")
        freeze_gc()
        server.run([listening])


def _listening(host: str, port: int) -> GuardedSocket:
    """The socket, opened here so that a port in use is an error of ours, with its address."""
    try:
        return GuardedSocket(host, port)
    except OSError as error:
        raise OSError(
            f"--listen {host_and_port(host, port)} cannot be used: {error.strerror}; give another port"
        ) from error
