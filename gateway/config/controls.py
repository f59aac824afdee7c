"""`[nc]`: the connection to the numerical control. One section per kind of control."""

import stat
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address
from pathlib import Path
from typing import Annotated, ClassVar, Literal
from urllib.parse import urlsplit

from pydantic import Field, model_validator

from drivers.base import SetupError
from drivers.linuxcnc.control import STATES as LINUXCNC_STATES
from drivers.linuxcnc.settings import DEFAULT_PORT, LARGEST_UM, LinuxCncSettings
from drivers.opcua.settings import OpcUaSettings, valid_certificate
from drivers.section import FilePath, NotNegative, Positive, Section, matching
from drivers.sinumerik.settings import (
    Handshake,
    LeaseParameters,
    OffsetRoute,
    Paths,
    SinumerikSettings,
    StateNode,
    default_states,
)
from gateway.config.fields import Name

_SOON = timedelta(days=30)


class SinumerikNc(Section):
    """A SINUMERIK control over OPC UA; docs/nc.md tells what each of these means on the control."""

    kind: Literal["sinumerik"]
    """`sinumerik`."""
    url: Annotated[str, matching(r"opc\.tcp://[^/:\s]+(:\d+)?(/\S*)?", "opc.tcp://host:port")]
    """Endpoint of the control's OPC UA server, such as `opc.tcp://192.168.214.1:4840`."""
    security: Literal["none", "Basic256Sha256"] = "Basic256Sha256"
    """`Basic256Sha256` signs and encrypts; `none` sends everything in the clear: for an emulated control only."""
    user: str | None = None
    """OPC UA user; the control grants it the rights to read and write."""
    password_file: FilePath | None = None
    """File that holds the user's password, so that it is never in this file, the store or a message."""
    certificate: FilePath | None = None
    """The gateway's certificate (.der or .pem); the control must trust it."""
    private_key: FilePath | None = None
    """The certificate's key (.pem)."""
    server_certificate: FilePath | None = None
    """The control's certificate (.der or .pem), copied from it: nobody else is then taken for the control."""
    namespace_uri: str = Field(default="SinumerikVarProvider", min_length=1)
    """Namespace of the control's variables; its index is looked up at every connect."""
    period_s: Positive = 1.0
    """How often positions and states are read, and compensation is written."""
    timeout_s: Positive = 2.0
    """How long one answer may take."""
    subscribe_s: NotNegative = 0.0
    """Have the control tell of changes this often instead of asking it every period; 0 asks. A control that offers no
    subscription, or falls silent, is asked."""
    axis_numbers: Mapping[str, int] = Field(default={"X": 1, "Y": 2, "Z": 3, "A": 4, "C": 5})
    """Number of each machine axis on the control."""
    origin_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Machine coordinates of X, Y, Z at which the tip of the tool is where A and C meet. What tilts shift grows with
    the distance from there."""
    nodes: Paths = Paths()
    states: Mapping[Name, StateNode] = Field(default_factory=dict)
    handshake: Handshake = Handshake()
    lease: LeaseParameters = LeaseParameters()
    compensation: OffsetRoute = OffsetRoute()

    @model_validator(mode="after")
    def _complete(self) -> "SinumerikNc":
        if self.security != "none" and (self.certificate is None or self.private_key is None):
            raise ValueError(f"security = '{self.security}' needs certificate and private_key")
        if (self.user is None) != (self.password_file is None):
            raise ValueError("user and password_file go together: give both or neither")
        return self

    def settings(self, poses: int, states: Iterable[str]) -> SinumerikSettings:
        """What the driver takes, for a probing cycle of `poses` poses.

        states: those of `known_states` that models use; only these are read, for a bit that nobody has wired must not
        keep the gateway from connecting. Raises SetupError naming the field and the value; no network.
        """
        known = self.known_states()
        shared = {f.name for f in fields(OpcUaSettings)} | {
            "subscribe_s", "axis_numbers", "origin_mm", "handshake", "lease", "compensation",
        }  # fmt: skip
        given = {name: getattr(self, name) for name in shared}
        return SinumerikSettings(
            **given | {"user": self.user or ""},
            paths=self.nodes,
            poses=poses,
            states={name: known[name] for name in states},
        )

    def known_states(self) -> Mapping[str, StateNode]:
        """Every machine state that can be an input."""
        return default_states(self.axis_numbers) | dict(self.states)

    def other_states(self, name: str) -> str:
        """What to do about a state that is not known."""
        return f', or say where it is: [nc.states.{name}] path = "/Plc/..."'

    largest_is: ClassVar[str] = "[nc.compensation] largest_um"

    @property
    def largest_um(self) -> float:
        """Offsets beyond are never sent."""
        return self.compensation.largest_um

    def cautions(self) -> Iterator[tuple[str, str]]:
        """Field, and what about it works today and may not tomorrow, or is less safe than it could be. Reads files."""
        if self.security == "none":
            if not _on_this_computer(self.url):
                yield "security", "'none' sends password and offsets in the clear; use Basic256Sha256"
        else:
            if self.server_certificate is None:
                yield "server_certificate", "missing; whoever answers at the control's address is taken for the control"
            for name in ("certificate", "server_certificate"):
                path = getattr(self, name)
                if path is not None:
                    yield from ((name, text) for text in _certificate_cautions(path, name))
        for name in ("password_file", "private_key"):
            path = getattr(self, name)
            if path is not None:
                yield from ((name, text) for text in _secret_cautions(path))


class LinuxCncNc(Section):
    """LinuxCNC through the agent of deploy/nc/linuxcnc; see docs/nc.md."""

    kind: Literal["linuxcnc"]
    """`linuxcnc`."""
    host: str = Field(default="127.0.0.1", min_length=1)
    """Where the agent listens. Beyond this computer use a tunnel: lines are signed but can be read on the way."""
    port: int = Field(default=DEFAULT_PORT, ge=1, le=65535)
    """The agent's port."""
    key_file: FilePath
    """File that holds the key shared with the agent: a copy of its talc.key."""
    period_s: Positive = 1.0
    """How often positions and states are read, and compensation is written."""
    timeout_s: Positive = 2.0
    """How long one answer may take."""

    def settings(self, poses: int, states: Iterable[str]) -> LinuxCncSettings:  # noqa: ARG002 - it tells all of them
        """What the driver takes, for a probing cycle of `poses` poses. Raises SetupError; no network."""
        return LinuxCncSettings(
            host=self.host, port=self.port, key_file=self.key_file, timeout_s=self.timeout_s, poses=poses
        )

    def known_states(self) -> Iterable[str]:
        """Every machine state that can be an input."""
        return LINUXCNC_STATES

    def other_states(self, name: str) -> str:  # noqa: ARG002
        """Nothing can be done about a state that is not known."""
        return ""

    largest_is: ClassVar[str] = "the driver's largest_um"

    @property
    def largest_um(self) -> float:
        """Offsets beyond are never sent; LinuxCNC's own bound is in its INI file."""
        return LARGEST_UM

    def cautions(self) -> Iterator[tuple[str, str]]:
        """Field, and what about it may not work, or is less safe than it could be. Reads files."""
        if not _is_loopback(self.host):
            yield "host", f"'{self.host}' is beyond this computer: use a tunnel, the lines are signed but not secret"
        yield from (("key_file", text) for text in _secret_cautions(self.key_file))


Nc = Annotated[SinumerikNc | LinuxCncNc, Field(discriminator="kind")]
"""Any control."""


def _on_this_computer(url: str) -> bool:
    return _is_loopback(urlsplit(url).hostname or "")


def _is_loopback(host: str) -> bool:
    try:
        return host == "localhost" or ip_address(host).is_loopback
    except ValueError:
        return False


def _certificate_cautions(path: Path, name: str) -> Iterator[str]:
    try:
        end = valid_certificate(path, name, "").not_valid_after_utc
    except SetupError as error:
        yield error.what
    else:
        if end - datetime.now(UTC) < _SOON:
            yield f"'{path}' ends on {end:%Y-%m-%d}; after that the control is no longer spoken to"


def _secret_cautions(path: Path) -> Iterator[str]:
    try:
        mode = path.stat().st_mode
    except OSError as error:
        yield f"'{path}' cannot be read: {error.strerror}"
    else:
        if mode & (stat.S_IRGRP | stat.S_IROTH):
            yield f"'{path}' can be read by others; chmod 600"
