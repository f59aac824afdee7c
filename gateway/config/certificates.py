"""The expiry dates of the certificates that a configuration names."""

from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.bounded_file import bytes_of

if TYPE_CHECKING:
    from gateway.config.model import GatewayConfig


def certificate_ends(config: "GatewayConfig") -> dict[str, datetime]:
    """By section and field, UTC; of several in a file the one that ends first. Reads files.

    One that cannot be read is left out: `talc-gateway check` says why.
    """
    return {field: ends for field, path in _named(config) if (ends := certificate_end(path)) is not None}


def certificate_end(path: Path) -> datetime | None:
    """When the first of a file's certificates (PEM or DER) ends, UTC; None: it cannot be read."""
    from cryptography import x509  # only where there are any: it takes long to load

    try:
        content = bytes_of(path)
        pem = b"-----BEGIN" in content
        found = x509.load_pem_x509_certificates(content) if pem else [x509.load_der_x509_certificate(content)]
    except (OSError, ValueError):
        return None
    return min(each.not_valid_after_utc for each in found)


def _named(config: "GatewayConfig") -> Iterator[tuple[str, Path]]:
    from drivers.opcua.settings import OpcUaServer  # the page asks only for the end of its own certificate

    tls = config.telemetry.tls
    sections = [("[telemetry.tls]", "certificate", tls.certificate), ("[telemetry.tls]", "authority", tls.authority)]
    holders: list[tuple[str, object]] = [*((f"bus '{bus.name}',", bus) for bus in config.buses), ("[nc]", config.nc)]
    for section, server in holders:
        if isinstance(server, OpcUaServer) and server.security != "none":
            sections.append((section, "certificate", server.certificate))
            sections.append((section, "server_certificate", server.server_certificate))
    yield from ((f"{section} {field}", path) for section, field, path in sections if path is not None)
