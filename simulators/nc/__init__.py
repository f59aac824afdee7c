"""An emulated numerical control: load case, probing cycle, NC kernel, and an OPC UA server that exposes them."""

from simulators.nc.access import Security, User
from simulators.nc.control import EmulatedControl, SimulatedClock
from simulators.nc.cycle import CycleSettings, ReasonCode
from simulators.nc.nck import MachineState, MachineUnderControl, Nck
from simulators.nc.nine_errors import FollowingTerms
from simulators.nc.program import Activity, DayPart, LoadCase, MeanLoads

__all__ = [
    "Activity",
    "CycleSettings",
    "DayPart",
    "EmulatedControl",
    "FollowingTerms",
    "LoadCase",
    "MachineState",
    "MachineUnderControl",
    "MeanLoads",
    "Nck",
    "ReasonCode",
    "Security",
    "SimulatedClock",
    "User",
]
