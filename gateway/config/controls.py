"""`[nc]`: the connection to the numerical control. One section per kind of control."""

from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal
from urllib.parse import urlsplit

from pydantic import Field

from drivers.agent.settings import AGENT_STATES, AgentAddress, AgentRequests, AgentSettings
from drivers.bus_settings import is_loopback
from drivers.linuxcnc.settings import ANALOG_OUTPUTS, LinuxCncSettings
from drivers.mtconnect.settings import MtConnectSettings
from drivers.nc import LARGEST_UM
from drivers.problems import settings_of
from drivers.section import host_and_port
from drivers.sinumerik.settings import SinumerikControl, SinumerikSettings, StateNode, default_states
from gateway.config.extensions import ControlSection, Poses
from gateway.config.fields import Name
from gateway.config.polled import PolledControl


class SinumerikNc(PolledControl, SinumerikControl):
    """A SINUMERIK control over OPC UA; docs/nc.md explains what these fields mean on the control."""

    kind: Literal["sinumerik"]
    """`sinumerik`."""
    states: Mapping[Name, StateNode] = Field(default_factory=dict)

    def settings(
        self,
        poses_deg: Poses,
        states: Iterable[str],
        *,
        asks: bool = True,
        writes: bool = True,
        watchdog_s: float | None = None,
    ) -> SinumerikSettings:
        """The driver's settings for a probing cycle of these poses.

        states: those of `known_states` that models use. Only these are read, so that a bit that is not wired does not
        keep the gateway from connecting. asks, writes: see SinumerikSettings. watchdog_s: of the control; a session
        that writes ends before it begins to ramp, so that no later write acts. Raises SetupError naming the field and
        the value; no network.
        """
        known = self.known_states()
        given: dict[str, object] = {name: getattr(self, name) for name in SinumerikControl.model_fields}
        chosen = {"poses": len(poses_deg), "states": {name: known[name] for name in states}}
        session = {"session_s": watchdog_s / 2} if writes and watchdog_s is not None else {}
        return settings_of(SinumerikSettings, given | chosen | session | {"asks": asks, "writes": writes})

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
        exposed = "" if _on_this_computer(self.url) else "password and offsets"
        yield from self.server_cautions(in_the_clear=exposed)


class PolledAgent(PolledControl, AgentAddress):
    """What every control with an agent has in common."""

    def settings(self, poses_deg: Poses, states: Iterable[str]) -> AgentSettings:  # noqa: ARG002 - it reports them all
        """The driver's settings for a probing cycle of these poses. Raises SetupError; no network."""
        return settings_of(AgentSettings, self._given(AgentSettings, poses_deg))

    def _given(self, kind: type[AgentSettings], poses_deg: Poses) -> dict[str, object]:
        """The driver's settings that are keys of this section, and the poses, which the agent may state too."""
        names = kind.model_fields.keys() & type(self).model_fields.keys()
        poses = {"poses": len(poses_deg), "poses_deg": tuple(poses_deg)}
        return {name: getattr(self, name) for name in names} | poses

    def known_states(self) -> Iterable[str]:
        """Every machine state that can be an input."""
        return AGENT_STATES

    def other_states(self, name: str) -> str:  # noqa: ARG002
        """An unknown state has no hint."""
        return ""

    @property
    def address(self) -> str:
        """Where the agent is, for messages."""
        return host_and_port(self.host, self.port)

    @property
    def largest_um(self) -> float:
        """Larger offsets are never sent; the agent's own bound is in its greeting."""
        return LARGEST_UM


class LinuxCncNc(PolledAgent):
    """LinuxCNC through the agent of deploy/nc/linuxcnc; see docs/linuxcnc.md."""

    kind: Literal["linuxcnc"]
    """`linuxcnc`."""

    def settings(self, poses_deg: Poses, states: Iterable[str]) -> LinuxCncSettings:  # noqa: ARG002
        """The same, with the poses of its probing program."""
        return settings_of(LinuxCncSettings, self._given(LinuxCncSettings, poses_deg))

    def known_states(self) -> Iterable[str]:
        """Every machine state that can be an input, or the stated tolerance."""
        return (*AGENT_STATES, *ANALOG_OUTPUTS)


class AgentNc(PolledAgent, AgentRequests):
    """Any control with an agent that speaks the protocol of docs/agent.md."""

    kind: Literal["agent"]
    """`agent`."""
    states: tuple[Name, ...] = ()
    """Machine states that this agent reports beside `spindle_speed`, `speed_X` to `speed_C` and `coolant`."""

    def known_states(self) -> Iterable[str]:
        """Every machine state that can be an input."""
        return (*AGENT_STATES, *self.states)

    def other_states(self, name: str) -> str:
        """Hint for an unknown state."""
        return f', or name it, if the agent reports it: [nc] states = ["{name}"]'


class MtConnectNc(PolledControl, MtConnectSettings):
    """A machine with an MTConnect agent, only read; see docs/agent.md."""

    kind: Literal["mtconnect"]
    """`mtconnect`."""

    only_read: ClassVar[bool] = True

    def settings(self, poses_deg: Poses, states: Iterable[str]) -> MtConnectSettings:  # noqa: ARG002 - it cannot probe
        """The driver's settings, with these of `known_states`. Raises SetupError; no network."""
        given: dict[str, object] = {name: getattr(self, name) for name in MtConnectSettings.model_fields}
        return settings_of(MtConnectSettings, given | {"states": {name: self.states[name] for name in states}})

    def known_states(self) -> Iterable[str]:
        """Every machine state that can be an input."""
        return self.states

    def other_states(self, name: str) -> str:
        """Hint for an unknown state."""
        return f', or name its data item: [nc.states] {name} = "..."'

    @property
    def address(self) -> str:
        """Where the agent is, for messages."""
        return self.url

    @property
    def largest_um(self) -> float:
        """Nothing is ever sent; the same as elsewhere, so that `bound_um` needs no change."""
        return LARGEST_UM

    def cautions(self) -> Iterator[tuple[str, str]]:
        """None: there is no secret, and nothing is written."""
        yield from ()


if TYPE_CHECKING:
    Nc = SinumerikNc | LinuxCncNc | AgentNc | MtConnectNc | ControlSection
else:  # gateway.config.extended adds those of other packages where a file uses them
    Nc = Annotated[SinumerikNc | LinuxCncNc | AgentNc | MtConnectNc, Field(discriminator="kind")]


def _on_this_computer(url: str) -> bool:
    return is_loopback(urlsplit(url).hostname or "")
