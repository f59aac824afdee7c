"""Settings of an OPC UA connection: address, certificates, ports. No network."""

from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal
from urllib.parse import urlsplit

from cryptography import x509

from drivers.base import SetupError

DEFAULT_PORT = 4840


@dataclass(frozen=True, slots=True, kw_only=True)
class OpcUaSettings:
    """Where a server is and how it is spoken to. Raises SetupError naming the field that cannot be."""

    url: str
    """opc.tcp://host:port; port 4840 when it is left out."""
    timeout_s: float = 2.0
    """Longest wait for one answer."""
    security: Literal["none", "Basic256Sha256"] = "none"
    """`Basic256Sha256` signs and encrypts and needs the three certificate files."""
    user: str = ""
    """Empty: anonymous."""
    password_file: Path | None = None
    """Holds the password alone, readable by the service only."""
    certificate: Path | None = None
    """Ours, .pem or .der; the control must trust it."""
    private_key: Path | None = None
    """Ours, .pem or .der."""
    server_certificate: Path | None = None
    """The control's, copied from it at commissioning: nobody else is taken for the control. None: whichever
    certificate the server shows is believed, which protects against listeners, not against impostors."""
    namespace_uri: str = "SinumerikVarProvider"
    """The index of this namespace is looked up at every connect."""

    def __post_init__(self) -> None:
        parts = urlsplit(self.url)
        if parts.scheme != "opc.tcp" or not parts.hostname:
            raise SetupError(f"url = {self.url!r}: expected opc.tcp://host:port")
        if not self.timeout_s > 0:
            raise SetupError(f"timeout_s = {self.timeout_s!r}: expected more than 0")
        if self.security not in ("none", "Basic256Sha256"):
            raise SetupError(f"security = {self.security!r}: expected 'none' or 'Basic256Sha256'")
        if bool(self.user) != (self.password_file is not None):
            raise SetupError("user and password_file: expected both or neither")
        for name in ("certificate", "private_key", "server_certificate"):
            path = getattr(self, name)
            if self.security == "none":
                continue
            if path is None:
                if name == "server_certificate":
                    continue
                raise SetupError(f"{name} is missing: security = 'Basic256Sha256' needs it")
            if path.suffix not in (".pem", ".der"):
                raise SetupError(f"{name} = {str(path)!r}: expected a file ending in .pem or .der")


def valid_certificate(path: Path | None, name: str, device: str) -> x509.Certificate:
    """The certificate in a file. Raises SetupError unless it is one and its time has come and not gone."""
    try:
        content = path.read_bytes() if path is not None else b""
        pem = content.startswith(b"-----BEGIN")
        certificate = x509.load_pem_x509_certificate(content) if pem else x509.load_der_x509_certificate(content)
    except (OSError, ValueError) as error:
        raise SetupError(f"{name} = {str(path)!r} cannot be used: {error}", device=device) from error
    begin, end = certificate.not_valid_before_utc, certificate.not_valid_after_utc
    if not begin <= datetime.now(UTC) <= end:
        raise SetupError(
            f"{name} = {str(path)!r} is valid from {begin:%Y-%m-%d %H:%M} to {end:%Y-%m-%d %H:%M} UTC, not now",
            device=device,
            hint="renew it; if it is new, check this computer's clock",
        )
    return certificate


def application_uri(certificate: x509.Certificate, path: Path | None, device: str) -> str:
    """The name that the certificate gives us; servers compare it with what we say of ourselves (Part 6, 6.2.2)."""
    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        uris = []
    else:
        uris = names.get_values_for_type(x509.UniformResourceIdentifier)
    if not uris:
        raise SetupError(f"certificate = {str(path)!r} holds no application URI as alternative name", device=device)
    return uris[0]


def with_port(url: str) -> str:
    """The URL with OPC UA's usual port when it names none."""
    parts = urlsplit(url)
    return url if parts.port is not None else parts._replace(netloc=f"{parts.netloc}:{DEFAULT_PORT}").geturl()
