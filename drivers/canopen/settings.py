"""Settings of a CANopen bus, and the options of a node."""

from typing import Literal

from pydantic import Field

from drivers.can import CanInterfaceSettings
from drivers.section import Section


class CanOpenSettings(CanInterfaceSettings):
    """CANopen nodes on a CAN bus."""


class Cia404Options(Section):
    """What a configuration may say about one node."""

    vendor: str
    """Which vendor's table of status bits applies; the profile lists them."""
    transfer: Literal["sdo", "sync", "timer"] = "sdo"
    """`sdo`: ask for each value; `sync`: send SYNC and take the node's TPDOs, much cheaper on the bus; `timer`: send
    nothing and take the TPDOs that the node sends by its event timer."""
    heartbeat_s: float = Field(default=0.0, ge=0, le=600)
    """For how long the node's heartbeat may be absent (consumer time); 0: three times what the node says in object
    1017, and no watch over a node that sends none."""
