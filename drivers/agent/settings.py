"""Settings of the connection to an agent on a control: address and shared key. No network."""

from collections.abc import Iterator
from typing import ClassVar, Final

from pydantic import Field

from drivers.base import SetupError
from drivers.bus_settings import BusSettings, Here, is_loopback
from drivers.credential_files import secret_cautions
from drivers.error_words import in_words
from drivers.nc import AXES, LARGEST_UM, REQUEST_VALID_FOR_S
from drivers.section import FilePath, HostName, NotNegative, Port, Positive, Section, ServerTime, host_and_port
from drivers.signature import shared_key
from drivers.text import Text, text_of

AGENT_PORT = 7621
AGENT_STATES: Final = ("spindle_speed", *(f"speed_{axis}" for axis in AXES), "coolant")
"""Every machine state that an agent is expected to report: 1/min, mm/min, 0 or 1."""


class AgentAddress(Section):
    """Where to find the agent, and the key that it shares with the gateway."""

    host: HostName = "127.0.0.1"
    """Host of the agent. If it is another computer, use a tunnel: lines are signed but not encrypted."""
    port: Port = AGENT_PORT
    """The agent's port."""
    key_file: FilePath
    """File with the key shared with the agent: a copy of the agent's."""
    timeout_s: ServerTime = 2.0
    """How long one answer may take."""

    def cautions(self) -> Iterator[tuple[str, str]]:
        """Field, and why it is less safe than it could be. Reads files."""
        if not is_loopback(self.host):
            yield "host", f"'{self.host}' is another computer: use a tunnel, lines are signed but not encrypted"
        yield from (("key_file", text) for text in secret_cautions(self.key_file))


class AgentBusSettings(AgentAddress, BusSettings):
    """A control with an agent whose values are channels, such as LinuxCNC's HAL pins; see docs/agent.md."""

    bus_kind: ClassVar[str] = "agent"
    unrecorded: ClassVar[str] = "a control's agent, which is signed,"

    @classmethod
    def moved(cls, to: Here) -> dict[str, object]:
        """The loopback, and no key of another place."""
        return {"host": "127.0.0.1", "port": to.port, "key_file": to.path}

    @property
    def place(self) -> str:
        """Host and port, which no two buses may share."""
        return host_and_port(self.host, self.port)


class AgentRequests(AgentAddress):
    """The same of an agent that is asked for probing cycles."""

    request_valid_for_s: NotNegative = REQUEST_VALID_FOR_S
    """A request for a probing cycle that reaches no safe point within this time is refused; 0: never."""


class AgentSettings(AgentRequests):
    """Settings of one control with an agent."""

    poses: int = Field(default=6, ge=1)
    """Number of poses that one probing cycle touches."""
    poses_deg: tuple[tuple[float, float], ...] = ()
    """A and C of each pose, degrees, compared with those of an agent that states its own; empty: not compared."""
    largest_um: Positive = LARGEST_UM
    """Larger offsets are never sent; the agent also has its own bound."""
    device: str = "nc"
    """Name in messages."""

    def key(self) -> bytes:
        """Raises SetupError when the file cannot be read or is too short to be a key."""
        try:
            return shared_key(self.key_file)
        except OSError as error:
            raise SetupError(
                Text("path_unreadable", path=str(self.key_file), why=in_words(error)), device=self.device
            ) from error
        except ValueError as error:
            raise SetupError(
                Text("file_useless", path=str(self.key_file), why=text_of(error)),
                device=self.device,
                hint=Text("agent_copy_key"),
            ) from error
