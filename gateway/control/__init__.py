"""The grid loop around the pure controller, training and the sensor check."""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from gateway.control.command_taker import AskReload, CommandTaker
    from gateway.control.explaining import Explanations
    from gateway.control.grid import GridSampler, Instant, Schedule
    from gateway.control.loop import GridLoop
    from gateway.control.measuring import Measuring
    from gateway.control.planned_loads import PlannedLoads, rows_remembered
    from gateway.control.sensor_watch import SeenBefore, SensorWatch
    from gateway.control.trainer import Trainings
else:
    __getattr__ = on_first_use(
        __name__,
        {
            ".command_taker": ("AskReload", "CommandTaker"),
            ".explaining": ("Explanations",),
            ".grid": ("GridSampler", "Instant", "Schedule"),
            ".loop": ("GridLoop",),
            ".measuring": ("Measuring",),
            ".planned_loads": ("PlannedLoads", "rows_remembered"),
            ".sensor_watch": ("SeenBefore", "SensorWatch"),
            ".trainer": ("Trainings",),
        },
    )

__all__ = [
    "AskReload",
    "CommandTaker",
    "Explanations",
    "GridLoop",
    "GridSampler",
    "Instant",
    "Measuring",
    "PlannedLoads",
    "Schedule",
    "SeenBefore",
    "SensorWatch",
    "Trainings",
    "rows_remembered",
]
