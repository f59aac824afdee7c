"""Settings of a CANopen bus, and the options of a node."""

from collections.abc import Iterable, Mapping
from typing import ClassVar, Literal

from pydantic import Field

from drivers.can.settings import CanInterfaceSettings
from drivers.section import Section


class CanOpenSettings(CanInterfaceSettings):
    """CANopen nodes on a CAN bus."""

    bus_kind: ClassVar[str] = "canopen"
    units: ClassVar[tuple[int, int]] = (1, 127)
    """First and last address on the bus."""

    def timeout_is_age(self, options: Iterable[Mapping[str, object]]) -> bool:
        """Where a node sends on its timer."""
        return any(chosen.get("transfer") == "timer" for chosen in options)


class NodeOptions(Section):
    """Options of any node in the configuration."""

    transfer: Literal["sdo", "sync", "timer"] = "sdo"
    """`sdo`: request each value; `sync`: send SYNC and receive the node's TPDOs, which loads the bus much less;
    `timer`: receive the TPDOs that the node sends on its event timer."""
    heartbeat_s: float = Field(default=0.0, ge=0, le=600)
    """How long the node's heartbeat may be absent (consumer time). 0: three times the producer time in the node's
    object 1017; a node that sends no heartbeat is then not monitored."""
    rest_ms: int = Field(default=0, ge=0, le=2000)
    """After each SDO answer this node is not asked for this long. By default the gateway finds out what it needs."""


class Cia404Options(NodeOptions):
    """Options of a node that follows CiA 404."""

    vendor: str | None = None
    """Which vendor's table of status bits applies; the profile lists them. None: none, and any bit that is set means a
    broken sensor."""
