"""Settings of a connection to an MQTT broker. No network."""

from typing import ClassVar, Self

from pydantic import Field, model_validator

from drivers.bus_settings import BusSettings, BusWire, Here
from drivers.section import FilePath, NotEmpty, ServerTime, both_or_neither, host_and_port, user_and_password, wrong
from drivers.server_url import UrlServer
from drivers.text import Text


class MqttServer(UrlServer):
    """Where a broker is and how to connect to it."""

    schemes: ClassVar[tuple[str, str]] = ("mqtts", "mqtt")
    default_ports: ClassVar[tuple[int, int]] = (8883, 1883)

    url: str
    """The broker, such as `mqtts://broker.plant.example`, with TLS; `mqtt://127.0.0.1` without. The default ports are
    8883 and 1883."""
    certificate: FilePath | None = None
    """Certificate of this client (PEM), for a broker that asks for one."""
    key: FilePath | None = None
    """Private key of `certificate` (PEM)."""
    user: NotEmpty | None = None
    """User of the broker."""
    password_file: FilePath | None = None
    """File that contains only the user's password; systemd can supply it (`LoadCredential=`)."""
    client_id: NotEmpty | None = None
    """Client identifier, where the broker's rules need one. Two clients with the same one disconnect each other. None:
    the broker assigns one."""
    keepalive_s: int = Field(default=30, ge=5, le=3600)
    """A broker that has been silent for this long is asked whether it is there; without an answer the connection is
    lost."""

    @model_validator(mode="after")
    def _sensible(self) -> Self:
        user_and_password(self.user, self.password_file)
        both_or_neither("certificate", self.certificate, "key", self.key)
        if not self.encrypted and self.certificate:
            raise wrong(Text("tls_certificate_alone", scheme="mqtts"), "certificate")
        return self

    @property
    def place(self) -> str:
        """Host and port."""
        return host_and_port(self.host, self.port)


class MqttBusSettings(MqttServer, BusSettings):
    """An MQTT broker whose topics are channels. `period_s`: at least a third of the longest time between messages."""

    bus_kind: ClassVar[str] = "mqtt"
    only_listens: ClassVar[bool] = True
    wire: ClassVar[BusWire | None] = "mqtt"

    timeout_s: ServerTime = 2.0
    """How long connecting may take, and how long the first read waits for topics that have had no message."""

    @classmethod
    def moved(cls, to: Here) -> dict[str, object]:
        """Without TLS and password."""
        secrets = ("authority", "certificate", "key", "user", "password_file")
        return {"url": f"mqtt://127.0.0.1:{to.port}", **dict.fromkeys(secrets)}
