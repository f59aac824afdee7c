"""Settings of a connection to an MQTT broker. No network."""

import re
from typing import Annotated, ClassVar, Self

from pydantic import Field, model_validator

from drivers.bus_settings import is_loopback
from drivers.section import FilePath, NotEmpty, Positive, Section, matching, wrong

PORT, TLS_PORT = 1883, 8883
_URL = re.compile(r"(?P<scheme>mqtts?)://(?P<host>\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9._-]+)(?::(?P<port>\d{1,5}))?")


class MqttServer(Section):
    """Where a broker is and how to connect to it."""

    url: Annotated[str, matching(_URL.pattern, "mqtts://HOST:PORT, or mqtt://HOST:PORT for a broker without TLS")]
    """The broker, such as `mqtts://broker.plant.example`, with TLS; `mqtt://127.0.0.1` without. The default ports are
    8883 and 1883."""
    allow_unencrypted: bool = False
    """Whether `mqtt://` may go beyond this computer: everyone in that network can then read and change what passes, and
    read the password."""
    authority: FilePath | None = None
    """Certificates of the authorities (PEM), one of which must have issued the broker's certificate. None: those that
    the operating system trusts."""
    certificate: FilePath | None = None
    """Certificate of this client (PEM), for a broker that asks for one."""
    key: FilePath | None = None
    """Private key of `certificate` (PEM)."""
    user: NotEmpty | None = None
    """User of the broker."""
    password_file: FilePath | None = None
    """File that holds only the user's password; systemd can supply it (`LoadCredential=`)."""
    client_id: NotEmpty | None = None
    """Client identifier, where the broker's rules need one. Two clients with the same one disconnect each other. None:
    the broker assigns one."""
    keepalive_s: int = Field(default=30, ge=5, le=3600)
    """A broker that has been silent for this long is asked whether it is there; without an answer the connection is
    lost."""

    @model_validator(mode="after")
    def _sensible(self) -> Self:
        if not 1 <= self.port <= 0xFFFF:
            raise wrong(f"{self.url!r}: expected a port of 1 to 65535", "url")
        if not (self.encrypted or self.allow_unencrypted or is_loopback(self.host)):
            raise wrong(
                f"{self.url!r} can be read and changed by everyone in that network: expected mqtts://, or a loopback "
                "address, or allow_unencrypted = true",
                "url",
            )
        if (self.user is None) != (self.password_file is None):
            raise ValueError("user and password_file go together: give both or neither")
        if (self.certificate is None) != (self.key is None):
            raise ValueError("certificate and key go together: give both or neither")
        if not self.encrypted and (self.authority or self.certificate):
            raise ValueError("authority, certificate and key have no effect without TLS: write mqtts:// in url")
        return self

    @property
    def encrypted(self) -> bool:
        """Whether it is by TLS."""
        return self.url.startswith("mqtts:")

    @property
    def host(self) -> str:
        """Without brackets."""
        found = _URL.fullmatch(self.url)
        return "" if found is None else found["host"].strip("[]")

    @property
    def port(self) -> int:
        """As stated, or the default one."""
        found = _URL.fullmatch(self.url)
        stated = None if found is None else found["port"]
        return int(stated) if stated is not None else TLS_PORT if self.encrypted else PORT

    @property
    def place(self) -> str:
        """Host and port."""
        return f"{self.host}:{self.port}"


class MqttBusSettings(MqttServer):
    """An MQTT broker whose topics are channels."""

    units: ClassVar[tuple[int, int]] = (1, 127)
    """First and last address on the bus."""

    timeout_s: Positive = 2.0
    """How long connecting may take, and how long the first read waits for topics that have had no message."""
