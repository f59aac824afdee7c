"""Settings of the OPC UA server beyond a gateway's configuration: whose machines these are, and who may read."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

from pydantic import Field, model_validator

from drivers.base import SetupError
from drivers.bus_settings import is_loopback
from drivers.section import FilePath, NotEmpty, Section
from gateway.config.fields import Name
from gateway.config.reading import read_as
from gateway.model.codes import NoticeCode
from gateway.model.text import Text
from gateway.runtime.passwords import UserName, hash_printed_by


class ServerSecurity(Section):
    """The server's certificate; with it the server speaks Basic256Sha256 with SignAndEncrypt only."""

    certificate: FilePath
    """The server's certificate (.der or .pem), which holds its application URI; clients must trust it."""
    private_key: FilePath
    """The certificate's key (.pem)."""


class ShownMachine(Section):
    """Nameplate of one machine, which no message tells."""

    manufacturer: NotEmpty = "unknown"
    """Who made the machine."""
    serial_number: NotEmpty = "unknown"
    """The manufacturer's."""
    product_instance_uri: NotEmpty | None = None
    """Globally unique URI of the machine, given by its manufacturer. None: `urn:talc-gateway:` and the name."""
    model: NotEmpty | None = None
    location: NotEmpty | None = None
    """Where the machine stands."""


class OpcUaServing(Section):
    """The server's own file."""

    security: ServerSecurity | None = None
    users: Mapping[UserName, Annotated[str, hash_printed_by("opcua")]] = Field(default_factory=dict)
    """Name and password hash of everybody who may read."""
    machines: Mapping[Name, ShownMachine] = Field(default_factory=dict, alias="machine")
    """By name of the machine; these are shown beside the machine of the configuration."""

    @model_validator(mode="after")
    def _together(self) -> "OpcUaServing":
        if (self.security is None) != (not self.users):
            raise ValueError(Text("both_or_neither", first="[security]", second="[users]"))
        return self


def load_serving(path: Path | None) -> OpcUaServing:
    """The checked file; without one the server is only for this computer. Raises ConfigError."""
    return OpcUaServing() if path is None else read_as(OpcUaServing, path)


def check_serving(host: str, serving: OpcUaServing) -> None:
    """Raises SetupError for an address beyond this computer without certificate and users."""
    if not is_loopback(host) and serving.security is None:
        raise SetupError(Text(NoticeCode.UMATI_OPEN, host=host))
