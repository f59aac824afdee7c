"""A five-axis machine's thermal behaviour. Physics only: no protocol, no clock. See docs/plant.md."""

from simulators.plant.ageing import Ageing, Failure
from simulators.plant.drive import MachineDrive
from simulators.plant.environment import Environment
from simulators.plant.parameters import MACHINES, PlantParameters, load
from simulators.plant.plant import Plant
from simulators.plant.record import PlantRecording, record

__all__ = [
    "MACHINES",
    "Ageing",
    "Environment",
    "Failure",
    "MachineDrive",
    "Plant",
    "PlantParameters",
    "PlantRecording",
    "load",
    "record",
]
