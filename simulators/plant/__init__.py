"""A five-axis machine's thermal behaviour. Physics only: no protocol, no clock. See docs/plant.md."""

from simulators.plant.drive import MachineDrive
from simulators.plant.environment import Environment
from simulators.plant.parameters import Parameters, load
from simulators.plant.plant import Plant
from simulators.plant.record import Recording, record

__all__ = ["Environment", "MachineDrive", "Parameters", "Plant", "Recording", "load", "record"]
