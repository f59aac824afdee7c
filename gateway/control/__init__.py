"""The grid loop around the pure controller, training and the sensor check."""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from gateway.control.command_taker import AskReload, CommandTaker
    from gateway.control.grid import GridSampler, Schedule
    from gateway.control.loop import GridLoop
    from gateway.control.planned_loads import PlannedLoads
    from gateway.control.sensor_watch import SeenBefore, SensorWatch
    from gateway.control.trainer import has_failed
else:
    __getattr__ = on_first_use(
        __name__,
        {
            ".command_taker": ("AskReload", "CommandTaker"),
            ".grid": ("GridSampler", "Schedule"),
            ".loop": ("GridLoop",),
            ".planned_loads": ("PlannedLoads",),
            ".sensor_watch": ("SeenBefore", "SensorWatch"),
            ".trainer": ("has_failed",),
        },
    )

__all__ = [
    "AskReload",
    "CommandTaker",
    "GridLoop",
    "GridSampler",
    "PlannedLoads",
    "Schedule",
    "SeenBefore",
    "SensorWatch",
    "has_failed",
]
