"""The grid loop around the pure controller, training and the sensor check."""

from gateway.control.command_taker import AskReload, CommandTaker
from gateway.control.grid import GridSampler, Schedule
from gateway.control.loop import GridLoop
from gateway.control.sensor_watch import SeenBefore, SensorWatch
from gateway.control.trainer import has_failed

__all__ = [
    "AskReload",
    "CommandTaker",
    "GridLoop",
    "GridSampler",
    "Schedule",
    "SeenBefore",
    "SensorWatch",
    "has_failed",
]
