"""Warnings about a connection to an OPC UA server: what may fail later, or is less safe than it could be."""

from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

from drivers.base import SetupError
from drivers.opcua import OpcUaServer
from gateway.config.credentials import ENDS_SOON, secret_cautions


def server_cautions(server: OpcUaServer, *, in_the_clear: str) -> Iterator[tuple[str, str]]:
    """Field and text. Reads files.

    in_the_clear: what security = "none" exposes; empty: nothing that matters
    """
    if server.security == "none":
        if in_the_clear:
            yield "security", f"'none' sends {in_the_clear} unencrypted; use Basic256Sha256"
    else:
        if server.server_certificate is None:
            yield "server_certificate", "missing; any server at this address is accepted"
        for name in ("certificate", "server_certificate"):
            path = getattr(server, name)
            if path is not None:
                yield from ((name, text) for text in _certificate_cautions(path, name))
        yield from (("private_key", text) for text in _key_cautions(server))
    for name in ("password_file", "private_key"):
        path = getattr(server, name)
        if path is not None:
            yield from ((name, text) for text in secret_cautions(path))


def _certificate_cautions(path: Path, name: str) -> Iterator[str]:
    from drivers.opcua import valid_certificate  # only where there are any: it loads cryptography

    try:
        end = valid_certificate(path, name, "").not_valid_after_utc
    except SetupError as error:
        yield error.what
    else:
        if end - datetime.now(UTC) < ENDS_SOON:
            yield f"'{path}' expires on {end:%Y-%m-%d}; renew it before then, or no connection is possible"


def _key_cautions(server: OpcUaServer) -> Iterator[str]:
    from drivers.opcua import check_key, valid_certificate

    try:
        certificate = valid_certificate(server.certificate, "certificate", "")
    except SetupError:
        return  # said already
    try:
        check_key(certificate, server.private_key, "")
    except SetupError as error:
        yield error.what
