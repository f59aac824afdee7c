"""Where a program beside a gateway hears it: as its configuration says, or as its options do."""

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from pydantic import ValidationError

from drivers.bounded_file import bytes_of
from drivers.section import both_or_neither
from gateway.config.fields import DEFAULT_PREFIX
from gateway.config.telemetry import Telemetry, TelemetryTls, endpoint
from gateway.config.telemetry_rules import credential_problems
from gateway.telemetry.session import Access
from gateway.telemetry.subscriber.site import listened_to

if TYPE_CHECKING:
    from gateway.config.model import GatewayConfig


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


def access_of(
    authority: Path | None, certificate: Path | None, key: Path | None, user: str | None, password_file: Path | None
) -> Access:
    """What a reader's options say. Raises click.UsageError when one is missing."""
    try:
        both_or_neither("--certificate", certificate, "--key", key)
        both_or_neither("--user", user, "--password-file", password_file)
    except ValueError as error:
        raise click.UsageError(str(error)) from None
    password = None if password_file is None else bytes_of(password_file).decode().strip()
    return Access(authority=authority, certificate=certificate, key=key, user=user, password=password)


def connected_to(connect: tuple[str, ...], prefix: str, proof: Mapping[str, Any]) -> Telemetry:
    """Where to connect and how. Raises click.UsageError.

    proof: `user`, `password_file`, and the files of TelemetryTls
    """
    login = {"user": proof["user"], "password_file": proof["password_file"]}
    files = {name: file for name, file in proof.items() if name not in login}
    try:
        telemetry = Telemetry(
            listen=(),
            connect=connect,
            prefix=prefix,
            tls=TelemetryTls(**files),
            **login,
        )
    except ValidationError as error:
        first = error.errors()[0]
        option = "".join(f"--{part}: " for part in first["loc"][:1])
        raise click.UsageError(option + str(first.get("ctx", {}).get("error", first["msg"]))) from None
    if any(place.encrypted for place in telemetry.connecting) and telemetry.tls.authority is None:
        raise click.UsageError("a tls/… endpoint needs --authority")
    for problem in credential_problems(telemetry, datetime.now(UTC)):
        raise click.UsageError(str(problem))
    return telemetry
