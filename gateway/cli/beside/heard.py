"""Shared parts of the programs beside a gateway: where they hear it, and hashes of passwords for their settings."""

from typing import TYPE_CHECKING

import click

from gateway.config.fields import DEFAULT_PREFIX
from gateway.config.telemetry import Telemetry, endpoint
from gateway.runtime.passwords import make_hash
from gateway.telemetry.subscriber.site import listened_to

if TYPE_CHECKING:
    from gateway.config.model import GatewayConfig


def print_hash() -> None:
    """Ask for a password, twice on a terminal, and print its hash."""
    password = click.prompt("password", hide_input=True, confirmation_prompt=True, err=True)
    click.echo(make_hash(password))


def heard_at(config: "GatewayConfig | None", connect: tuple[str, ...], prefix: str | None) -> Telemetry:
    """Where to listen. Raises click.UsageError.

    config: of a gateway on this computer; None: only what `connect` says
    """
    for text in connect:
        try:
            endpoint(text)
        except ValueError as error:
            raise click.BadParameter(str(error), param_hint="--connect") from None
    if config is None:
        return Telemetry(connect=connect, prefix=prefix or DEFAULT_PREFIX)
    telemetry = config.telemetry
    if not telemetry.enabled:
        raise click.UsageError("[telemetry] enabled = false: this gateway publishes nothing that could be shown")
    places = (*connect, *listened_to(telemetry))
    if not places and not telemetry.multicast:
        raise click.UsageError(
            "there is nothing to listen to: [telemetry] has neither listen nor connect; give --connect tcp/HOST:7447"
        )
    return telemetry.model_copy(update={"connect": places, "prefix": prefix or telemetry.prefix})
