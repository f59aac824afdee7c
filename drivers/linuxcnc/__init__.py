"""LinuxCNC, through the agent that runs on the control."""

from drivers.linuxcnc.control import STATES, LinuxCnc
from drivers.linuxcnc.settings import LARGEST_UM, LinuxCncAgent, LinuxCncSettings

__all__ = ["LARGEST_UM", "STATES", "LinuxCnc", "LinuxCncAgent", "LinuxCncSettings"]
