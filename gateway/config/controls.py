"""`[nc]`: the connection to the numerical control. One section per kind of control."""

from collections.abc import Iterable, Iterator, Mapping
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address
from pathlib import Path
from typing import Annotated, ClassVar, Literal
from urllib.parse import urlsplit

from pydantic import Field

from drivers.base import SetupError
from drivers.linuxcnc import LARGEST_UM, LinuxCncAgent, LinuxCncSettings
from drivers.linuxcnc import STATES as LINUXCNC_STATES
from drivers.opcua import valid_certificate
from drivers.problems import settings_of
from drivers.section import Positive
from drivers.sinumerik import SinumerikControl, SinumerikSettings, StateNode, default_states
from gateway.config.credentials import secret_cautions
from gateway.config.fields import Name

_SOON = timedelta(days=30)


class SinumerikNc(SinumerikControl):
    """A SINUMERIK control over OPC UA; docs/nc.md explains what these fields mean on the control."""

    kind: Literal["sinumerik"]
    """`sinumerik`."""
    period_s: Positive = 1.0
    """Interval at which positions and states are read and compensation is written."""
    states: Mapping[Name, StateNode] = Field(default_factory=dict)

    def settings(self, poses: int, states: Iterable[str]) -> SinumerikSettings:
        """The driver's settings for a probing cycle of `poses` poses.

        states: those of `known_states` that models use. Only these are read, so that a bit that is not wired does not
        keep the gateway from connecting. Raises SetupError naming the field and the value; no network.
        """
        known = self.known_states()
        given: dict[str, object] = {name: getattr(self, name) for name in SinumerikControl.model_fields}
        chosen = {"poses": poses, "states": {name: known[name] for name in states}}
        return settings_of(SinumerikSettings, given | chosen)

    def known_states(self) -> Mapping[str, StateNode]:
        """Every machine state that can be an input."""
        return default_states(self.axis_numbers) | dict(self.states)

    def other_states(self, name: str) -> str:
        """Hint for an unknown state."""
        return f', or give its address: [nc.states.{name}] path = "/Plc/..."'

    largest_is: ClassVar[str] = "[nc.compensation] largest_um"

    @property
    def address(self) -> str:
        """Where the control is, for messages."""
        return self.url

    @property
    def largest_um(self) -> float:
        """Larger offsets are never sent."""
        return self.compensation.largest_um

    def cautions(self) -> Iterator[tuple[str, str]]:
        """Field, and why it may fail later or is less safe than it could be. Reads files."""
        if self.security == "none":
            if not _on_this_computer(self.url):
                yield "security", "'none' sends password and offsets unencrypted; use Basic256Sha256"
        else:
            if self.server_certificate is None:
                yield "server_certificate", "missing; any server at the control's address is accepted"
            for name in ("certificate", "server_certificate"):
                path = getattr(self, name)
                if path is not None:
                    yield from ((name, text) for text in _certificate_cautions(path, name))
        for name in ("password_file", "private_key"):
            path = getattr(self, name)
            if path is not None:
                yield from ((name, text) for text in secret_cautions(path))


class LinuxCncNc(LinuxCncAgent):
    """LinuxCNC through the agent of deploy/nc/linuxcnc; see docs/nc.md."""

    kind: Literal["linuxcnc"]
    """`linuxcnc`."""
    period_s: Positive = 1.0
    """Interval at which positions and states are read and compensation is written."""

    def settings(self, poses: int, states: Iterable[str]) -> LinuxCncSettings:  # noqa: ARG002 - it reports all of them
        """The driver's settings for a probing cycle of `poses` poses. Raises SetupError; no network."""
        given: dict[str, object] = {name: getattr(self, name) for name in LinuxCncAgent.model_fields}
        return settings_of(LinuxCncSettings, given | {"poses": poses})

    def known_states(self) -> Iterable[str]:
        """Every machine state that can be an input."""
        return LINUXCNC_STATES

    def other_states(self, name: str) -> str:  # noqa: ARG002
        """An unknown state has no hint."""
        return ""

    largest_is: ClassVar[str] = "the driver's largest_um"

    @property
    def address(self) -> str:
        """Where the agent is, for messages."""
        return f"{self.host}:{self.port}"

    @property
    def largest_um(self) -> float:
        """Larger offsets are never sent; LinuxCNC's own bound is in its INI file."""
        return LARGEST_UM

    def cautions(self) -> Iterator[tuple[str, str]]:
        """Field, and why it may fail or is less safe than it could be. Reads files."""
        if not _is_loopback(self.host):
            yield (
                "host",
                f"'{self.host}' is another computer: use a tunnel, lines are signed but not encrypted",
            )
        yield from (("key_file", text) for text in secret_cautions(self.key_file))


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
            yield f"'{path}' ends on {end:%Y-%m-%d}; after that the gateway no longer connects to the control"
