"""The section [telemetry]: where the gateway is reached over Zenoh, how that is secured, and who may read."""

import re
from dataclasses import dataclass
from ipaddress import ip_address
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from drivers.bus_settings import is_loopback
from drivers.section import (
    FilePath,
    NotEmpty,
    Section,
    both_or_neither,
    host_and_port,
    host_name,
    matching,
    user_and_password,
    without_brackets,
    wrong,
)
from drivers.text import shown
from gateway.config.fields import DEFAULT_PREFIX, LOOPBACK, KeyPrefix
from gateway.model.codes import NoticeCode
from gateway.model.commands import CommandName
from gateway.model.text import Text

_PROTOCOLS = ("tcp", "tls", "quic", "udp", "ws")
_ENCRYPTED = ("tls", "quic")
_ENDPOINT = re.compile(
    r"(?P<protocol>[a-z]+)/(?P<host>\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9._-]+):(?P<port>\d{1,5})(?:[?#].*)?"
)
_LOCAL_SOCKET = re.compile(r"unixsock-stream/.+")


@dataclass(frozen=True, slots=True)
class EndpointParts:
    """What an endpoint says."""

    text: str
    protocol: str
    host: str
    """Without brackets; empty for a socket in the file system."""
    port: int

    @property
    def encrypted(self) -> bool:
        """Whether it is by TLS."""
        return self.protocol in _ENCRYPTED

    @property
    def local(self) -> bool:
        """Whether only this computer reaches it."""
        return not self.host or is_loopback(self.host)

    @property
    def from_here(self) -> str:
        """The endpoint by which a program on this computer reaches who listens here: every address is also loopback."""
        try:
            everywhere = ip_address(self.host).is_unspecified
        except ValueError:
            everywhere = False
        if not everywhere:
            return self.text
        host = "::1" if ":" in self.host else "127.0.0.1"
        return f"{self.protocol}/{host_and_port(host, self.port)}"


def endpoint(text: str) -> EndpointParts:
    """The parts of a Zenoh endpoint. Raises ValueError naming it and what would be right."""
    if _LOCAL_SOCKET.fullmatch(text):
        return EndpointParts(text, "unixsock-stream", "", 0)
    found = _ENDPOINT.fullmatch(text)
    if found is None or found["protocol"] not in _PROTOCOLS or not 1 <= int(found["port"]) <= 0xFFFF:
        raise ValueError(Text(NoticeCode.ENDPOINT_FORM, value=shown(text), such=LOOPBACK))
    host = host_name(without_brackets(found["host"]))
    return EndpointParts(text, found["protocol"], host, int(found["port"]))


def _valid(text: str) -> str:
    endpoint(text)
    return text


Endpoint = Annotated[str, AfterValidator(_valid)]


class TelemetryTls(Section):
    """Encryption of `tls/…` endpoints: this gateway's certificate, and the authorities that it trusts. PEM files;
    `deploy/zenoh/certificates.sh` makes them."""

    certificate: FilePath | None = None
    """Certificate of this gateway, needed to listen on `tls/…`, and shown to a router that asks for one; see `mutual`.
    It must name the host or address by which others connect."""
    key: FilePath | None = None
    """Private key of `certificate`, readable only by the gateway and the programs beside it."""
    authority: FilePath | None = None
    """Certificates of the authorities that must have issued the others' certificates; needed to connect to `tls/…` and
    for `mutual`."""
    mutual: bool = False
    """Clients must show a certificate that `authority` issued. A gateway that listens on `tls/…` shows its own to a
    router only if this is true; one that only connects always does."""

    @model_validator(mode="after")
    def _together(self) -> "TelemetryTls":
        both_or_neither("certificate", self.certificate, "key", self.key)
        if self.mutual and (self.authority is None or self.certificate is None):
            raise wrong(Text(NoticeCode.MUTUAL_ALONE), "mutual")
        return self


class Operator(Section):
    """Somebody who may give commands (docs/commands.md). Without such a table the gateway accepts no commands."""

    name: Annotated[str, matching(r"[A-Za-z0-9._@-]{1,64}", NoticeCode.AN_OPERATOR_NAME)]
    """Name of the person; every command is stored with it."""
    key_file: FilePath
    """File with the key that proves who gives a command: 32 characters or more, known only to the gateway and the
    person."""
    may: tuple[CommandName, ...] = Field(min_length=1)
    """The commands that this person may give, such as `["measure", "pause"]`."""


class Telemetry(Section):
    """Publication over Zenoh."""

    enabled: bool = True
    """False: publish nothing and open no session."""
    prefix: KeyPrefix = DEFAULT_PREFIX
    """First part of every published key; the machine's name follows."""
    mode: Literal["peer", "client"] = "peer"
    """`peer` meets others directly, `client` goes through a router."""
    listen: tuple[Endpoint, ...] = (LOOPBACK,)
    """Zenoh endpoints to listen on, such as `tls/0.0.0.0:7447`. By default only this computer can reach the gateway."""
    connect: tuple[Endpoint, ...] = ()
    """Zenoh endpoints to connect to, such as a router's `tls/192.168.1.5:7447`."""
    multicast: bool = False
    """Find other peers by multicast."""
    allow_unencrypted: bool = False
    """Whether the gateway may listen beyond this computer on endpoints without TLS: everyone in that network can then
    read what it publishes."""
    tls: TelemetryTls = TelemetryTls()
    user: NotEmpty | None = None
    """Name under which it connects to a router that asks for user and password."""
    password_file: FilePath | None = None
    """File that contains only the user's password."""
    users_file: FilePath | None = None
    """File with lines of `user:password`: only these users may connect to this gateway. Use TLS too."""
    readers: tuple[NotEmpty, ...] = ()
    """Clients that may read and query: common names of certificates (`mutual`) or users (`users_file`). Empty: all
    clients. The gateway forwards nothing that a client sends, and no client can write the gateway's keys."""
    operators: tuple[Operator, ...] = Field(default=(), alias="operator")

    @model_validator(mode="after")
    def _together(self) -> "Telemetry":
        user_and_password(self.user, self.password_file)
        return self

    @property
    def listening(self) -> tuple[EndpointParts, ...]:
        """Where it listens; a client never does."""
        return tuple(endpoint(text) for text in self.listen) if self.mode == "peer" else ()

    @property
    def connecting(self) -> tuple[EndpointParts, ...]:
        """What it connects to."""
        return tuple(endpoint(text) for text in self.connect)
