"""An emulated numerical control: load case, probing cycle, NC kernel, and an OPC UA server that shows them."""

from simulators.nc.access import Security, User
from simulators.nc.control import EmulatedControl
from simulators.nc.cycle import CycleSettings, Reason
from simulators.nc.nck import MachineState, MachineUnderControl, Nck
from simulators.nc.program import Block, Kind, LoadCase, Loads

__all__ = [
    "Block",
    "CycleSettings",
    "EmulatedControl",
    "Kind",
    "LoadCase",
    "Loads",
    "MachineState",
    "MachineUnderControl",
    "Nck",
    "Reason",
    "Security",
    "User",
]
