"""`[nc]` of kind `ads`."""

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from pydantic import Field

from drivers.base import Clock, SetupError
from drivers.section import NotEmpty, Port, Section, ServerTime, matching
from gateway.config.extensions import ControlSection

if TYPE_CHECKING:
    from talc_ads.control import AdsControl

AXES = ("X", "Y", "Z", "A", "C")
NetId = Annotated[str, matching(r"(\d{1,3}\.){5}\d{1,3}", "six numbers with dots between, such as 192.168.0.40.1.1")]


class AdsState(Section):
    """A machine state."""

    symbol: NotEmpty
    """Name of the PLC's variable."""
    factor: float = 1.0
    """From its unit to the gateway's: 60 for an `ActVelo` in mm/s."""


class AdsSection(ControlSection):
    """A TwinCAT PLC that is only read."""

    kind: Literal["ads"]
    """`ads`."""
    host: NotEmpty
    """Its address. The PLC needs an AMS route to this computer."""
    net_id: NetId
    """Its AMS NetId."""
    ams_port: Port = 851
    """AMS port of the PLC's runtime."""
    positions: Mapping[str, NotEmpty]
    """X, Y, Z, A and C, each with the name of the PLC's variable: mm and degrees, of the tool's tip."""
    origin_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """X, Y, Z of these variables at which the tip of the tool is where A and C meet."""
    states: Mapping[str, AdsState] = Field(default_factory=dict)
    """Machine states."""
    ready: str = ""
    """Name of a BOOL that is TRUE while drives are on, axes are referenced and there is no emergency stop."""
    timeout_s: ServerTime = 2.0
    """How long one answer may take."""

    only_read: ClassVar[bool] = True

    @property
    def address(self) -> str:
        return f"{self.host}, AMS {self.net_id}:{self.ams_port}"

    def known_states(self) -> Iterable[str]:
        return self.states

    def other_states(self, name: str) -> str:
        return f', or name its variable: [nc.states.{name}] symbol = "..."'

    def control(self, poses_deg: object, states: Iterable[str], clock: Clock) -> "AdsControl":
        if set(self.positions) != set(AXES):
            given = ", ".join(self.positions)
            raise SetupError(f"positions = {given}: expected a variable for each of {', '.join(AXES)}")
        from talc_ads.control import AdsControl  # loads Beckhoff's library

        return AdsControl(self, clock, tuple(states))
