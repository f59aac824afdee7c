"""`talc-gateway web`: serves the page for operators. It only listens, so it can touch nothing of a machine."""

import socket
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import click
import uvicorn

from gateway.config import GatewayConfig, Telemetry, endpoint
from gateway.web import (
    MachineUse,
    SiteSeen,
    SiteSubscription,
    build_app,
    check_certificate,
    check_listening,
    listened_to,
    load_settings,
    make_hash,
)

_GOODBYE_S = 2
"""Streams never end by themselves: open pages are cut after this time when the page stops."""


@dataclass(frozen=True, slots=True)
class WebCommand:
    """What to serve."""

    config: GatewayConfig | None
    """Of a gateway on this computer; None: only what `connect` says."""
    connect: tuple[str, ...]
    prefix: str | None
    settings: Path | None
    host: str
    port: int


def print_hash() -> None:
    """Ask for a password, twice on a terminal, and print its hash."""
    password = click.prompt("password", hide_input=True, confirmation_prompt=True, err=True)
    click.echo(make_hash(password))


def serve_pages(command: WebCommand) -> None:
    """Serve until SIGINT or SIGTERM. Raises ConfigError, SetupError, TelemetryError, OSError."""
    settings = load_settings(command.settings)
    check_listening(command.host, settings)
    if settings.tls is not None:
        check_certificate(settings.tls)
    telemetry = _telemetry(command)
    expected: Sequence[str] = tuple(settings.machines)
    uses: dict[str, MachineUse] = {}
    if command.config is not None:
        name, probing = command.config.machine.name, command.config.probing
        expected = (name, *expected)
        uses[name] = MachineUse(sphere_radius_mm=probing.sphere_radius_mm, sphere_height_mm=probing.sphere_height_mm)
    site = SiteSeen(telemetry.prefix, expected)
    app = build_app(site, settings, SiteSubscription(site, telemetry), uses)
    with closing(_listening(command.host, command.port)) as listening:
        tls = settings.tls
        server = uvicorn.Server(
            uvicorn.Config(
                app,
                log_level="warning",
                access_log=False,
                server_header=False,
                proxy_headers=False,
                timeout_graceful_shutdown=_GOODBYE_S,
                ssl_certfile=None if tls is None else str(tls.certificate),
                ssl_keyfile=None if tls is None else str(tls.key),
            )
        )
        host, port = listening.getsockname()[:2]
        shown = f"[{host}]" if ":" in host else host
        click.echo(f"{'http' if tls is None else 'https'}://{shown}:{port}/")
        server.run([listening])


def _telemetry(command: WebCommand) -> Telemetry:
    """Where to listen. Raises click.UsageError."""
    for text in command.connect:
        try:
            endpoint(text)
        except ValueError as error:
            raise click.BadParameter(str(error), param_hint="--connect") from None
    config = command.config
    if config is None:
        return Telemetry(connect=command.connect, prefix=command.prefix or "talc")
    telemetry = config.telemetry
    if not telemetry.enabled:
        raise click.UsageError("[telemetry] enabled = false: this gateway publishes nothing that a page could show")
    places = (*command.connect, *listened_to(telemetry))
    if not places and not telemetry.multicast:
        raise click.UsageError(
            "there is nothing to listen to: [telemetry] has neither listen nor connect; give --connect tcp/HOST:7447"
        )
    return telemetry.model_copy(update={"connect": places, "prefix": command.prefix or telemetry.prefix})


def _listening(host: str, port: int) -> socket.socket:
    """The socket, opened here so that a port in use is an error of ours, with its address."""
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        found = socket.socket(family, kind, protocol)
        try:
            found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            found.bind(address)
            found.listen()  # a browser that follows the printed address at once waits
        except OSError:
            found.close()
            raise
    except OSError as error:
        raise OSError(f"--listen {host}:{port} cannot be used: {error.strerror}; give another port") from error
    return found
