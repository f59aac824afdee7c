"""Settings of an OPC UA connection: address, certificates, ports. No network."""

from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Literal, Self
from urllib.parse import urlsplit

from cryptography import x509
from pydantic import model_validator

from drivers.base import SetupError
from drivers.section import FilePath, NotEmpty, Positive, Section, matching, wrong

DEFAULT_PORT = 4840


class OpcUaSettings(Section):
    """Where a server is and how to connect to it."""

    url: Annotated[str, matching(r"opc\.tcp://[^/:\s]+(:\d+)?(/\S*)?", "opc.tcp://host:port")]
    """Endpoint of the control's OPC UA server, such as `opc.tcp://192.168.214.1:4840`; 4840 is the default port."""
    security: Literal["none", "Basic256Sha256"] = "Basic256Sha256"
    """`Basic256Sha256` signs and encrypts; `none` sends everything unencrypted: for an emulated control only."""
    user: str | None = None
    """OPC UA user; the control grants it the rights to read and write."""
    password_file: FilePath | None = None
    """File that holds the user's password, so that it never appears in this file, the store or a message."""
    certificate: FilePath | None = None
    """The gateway's certificate (.der or .pem); the control must trust it."""
    private_key: FilePath | None = None
    """The certificate's key (.pem)."""
    server_certificate: FilePath | None = None
    """The control's certificate (.der or .pem), copied from it: no other server is then accepted."""
    namespace_uri: NotEmpty = "SinumerikVarProvider"
    """Namespace of the control's variables; its index is looked up at every connect."""
    timeout_s: Positive = 2.0
    """How long one answer may take."""

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if (self.user is None) != (self.password_file is None):
            raise ValueError("user and password_file go together: give both or neither")
        if self.security == "none":
            return self
        if self.certificate is None or self.private_key is None:
            raise ValueError(f"security = '{self.security}' needs certificate and private_key")
        for name in ("certificate", "private_key", "server_certificate"):
            path = getattr(self, name)
            if path is not None and path.suffix not in (".pem", ".der"):
                raise wrong(f"{str(path)!r}: expected a file ending in .pem or .der", name)
        return self


def valid_certificate(path: Path | None, name: str, device: str) -> x509.Certificate:
    """The certificate in a file. Raises SetupError unless it is one and is valid at present."""
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
    """The certificate's application URI; servers compare it with the one that we send (Part 6, 6.2.2)."""
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
    """The URL, with OPC UA's usual port added when it names none."""
    parts = urlsplit(url)
    return url if parts.port is not None else parts._replace(netloc=f"{parts.netloc}:{DEFAULT_PORT}").geturl()
