"""A five-axis machine's thermal behaviour. Physics only: no protocol, no clock. See docs/plant.md."""

from simulators.plant.ageing import Ageing, Failure, FailureKind
from simulators.plant.body import FloatArray
from simulators.plant.drive import MachineDrive
from simulators.plant.environment import Environment
from simulators.plant.parameters import (
    MACHINES,
    PlantParameters,
    assemble_machine,
    load_machine,
    machine_tables,
    reduced,
)
from simulators.plant.plant import RADIUS_MM, STEP_S, Plant
from simulators.plant.recording import PlantRecording, record_drive

__all__ = [
    "MACHINES",
    "RADIUS_MM",
    "STEP_S",
    "Ageing",
    "Environment",
    "Failure",
    "FailureKind",
    "FloatArray",
    "MachineDrive",
    "Plant",
    "PlantParameters",
    "PlantRecording",
    "assemble_machine",
    "load_machine",
    "machine_tables",
    "record_drive",
    "reduced",
]
