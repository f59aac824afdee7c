"""Settings of an OPC UA connection: address, certificates, ports. No network."""

from collections.abc import Iterator
from typing import Annotated, ClassVar, Literal, Self
from urllib.parse import urlsplit

from pydantic import AfterValidator, model_validator

from drivers.bus_settings import BusSettings, Here
from drivers.credential_files import secret_cautions
from drivers.section import FilePath, NotEmpty, Section, ServerTime, matching, user_and_password, wrong
from drivers.text import Text, shown

_DEFAULT_PORT = 4840

_FORM = r"(?i:opc\.tcp)://(\[[0-9A-Fa-f:.]+\]|[^/:\s\[\]]+)(:\d+)?(/\S*)?"


def _scheme_lower(url: str) -> str:
    scheme, mark, rest = url.partition("://")
    return f"{scheme.lower()}{mark}{rest}"


ServerUrl = Annotated[str, matching(_FORM, "opcua_an_url"), AfterValidator(_scheme_lower)]


class OpcUaServer(Section):
    """Where a server is and how to connect to it."""

    url: ServerUrl
    """Endpoint of the OPC UA server, such as `opc.tcp://192.168.214.1:4840`; 4840 is the default port."""
    security: Literal["none", "Basic256Sha256", "Aes128_Sha256_RsaOaep", "Aes256_Sha256_RsaPss"] = "Basic256Sha256"
    """The policy with which everything is signed and encrypted, one that the server offers; `none` sends everything
    unencrypted: never for a control to which offsets are written."""
    user: str | None = None
    """OPC UA user; the server grants it the rights to read and write."""
    password_file: FilePath | None = None
    """File that contains the user's password, so that it never appears in this file, the store or a message."""
    certificate: FilePath | None = None
    """The gateway's certificate (.der or .pem); the server must trust it."""
    private_key: FilePath | None = None
    """The certificate's key (.pem)."""
    server_certificate: FilePath | None = None
    """The server's certificate (.der or .pem), copied from it: no other server is then accepted."""
    timeout_s: ServerTime = 2.0
    """How long one answer may take."""

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if not _has_possible_port(self.url):
            raise wrong(Text("a_port", value=shown(self.url)), "url")
        user_and_password(self.user, self.password_file)
        if self.security == "none":
            return self
        if self.certificate is None or self.private_key is None:
            raise wrong(Text("opcua_needs_key", security=self.security), "security")
        for name in ("certificate", "private_key", "server_certificate"):
            path = getattr(self, name)
            if path is not None and path.suffix not in (".pem", ".der"):
                raise wrong(Text("opcua_ending", path=str(path)), name)
        return self

    def server_cautions(self, *, in_the_clear: str) -> Iterator[tuple[str, str]]:
        """Field, and why it may fail later or is less safe than it could be. Reads files.

        in_the_clear: what security = "none" exposes; empty: nothing that matters
        """
        if self.security != "none":
            yield from self._certificates_cautions()
        elif in_the_clear:
            yield "security", f"'none' sends {in_the_clear} unencrypted; use Basic256Sha256"
        for name in ("password_file", "private_key"):
            path = getattr(self, name)
            if path is not None:
                yield from ((name, text) for text in secret_cautions(path))

    def _certificates_cautions(self) -> Iterator[tuple[str, str]]:
        from drivers.opcua.certificates import certificate_cautions, key_cautions  # loads cryptography

        if self.server_certificate is None:
            yield "server_certificate", "missing; any server at this address is accepted"
        for name in ("certificate", "server_certificate"):
            path = getattr(self, name)
            if path is not None:
                yield from ((name, text) for text in certificate_cautions(path, name))
        yield from (("private_key", text) for text in key_cautions(self.certificate, self.private_key))


class OpcUaSettings(OpcUaServer):
    """A control's server."""

    namespace_uri: NotEmpty = "SinumerikVarProvider"
    """Namespace of the control's variables; its index is looked up at every connect."""


class OpcUaBusSettings(OpcUaServer, BusSettings):
    """An OPC UA server whose nodes are channels."""

    bus_kind: ClassVar[str] = "opcua"
    unrecorded: ClassVar[str] = "an OPC UA session"

    def cautions(self) -> Iterator[tuple[str, str]]:
        """Of its certificates and secrets."""
        return self.server_cautions(in_the_clear="the password" if self.password_file is not None else "")

    @classmethod
    def moved(cls, to: Here) -> dict[str, object]:
        """The loopback."""
        return {"url": f"opc.tcp://127.0.0.1:{to.port}"}

    @property
    def place(self) -> str:
        """The endpoint, which no two buses may share."""
        return with_port(self.url)


def _has_possible_port(url: str) -> bool:
    try:
        return urlsplit(url).port != 0
    except ValueError:
        return False


def with_port(url: str) -> str:
    """The URL, with OPC UA's usual port added when it names none."""
    parts = urlsplit(url)
    return url if parts.port is not None else parts._replace(netloc=f"{parts.netloc}:{_DEFAULT_PORT}").geturl()
