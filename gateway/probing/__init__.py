"""Probing: when to request a cycle from the control, and whether to use its result."""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from gateway.probing.cycle import End, Held, InForce, NotBegun, Outcome, Probe, Rejected, number_after, probe_of
    from gateway.probing.dry_run import DryRun, run_dry
    from gateway.probing.geometry import Geometry, barrier, geometry_of, is_of, recorded
    from gateway.probing.prober import Prober
    from gateway.probing.schedule import Bulletin, Outlook, ProbingSchedule, excess, schedule_of
    from gateway.probing.standing import Standing
    from gateway.probing.uninterrupted import to_its_end
else:
    __getattr__ = on_first_use(
        __name__,
        {
            ".cycle": (
                "End",
                "Held",
                "InForce",
                "NotBegun",
                "Outcome",
                "Probe",
                "Rejected",
                "number_after",
                "probe_of",
            ),
            ".dry_run": ("DryRun", "run_dry"),
            ".geometry": ("Geometry", "barrier", "geometry_of", "is_of", "recorded"),
            ".prober": ("Prober",),
            ".schedule": ("Bulletin", "Outlook", "ProbingSchedule", "excess", "schedule_of"),
            ".standing": ("Standing",),
            ".uninterrupted": ("to_its_end",),
        },
    )

__all__ = [
    "Bulletin",
    "DryRun",
    "End",
    "Geometry",
    "Held",
    "InForce",
    "NotBegun",
    "Outcome",
    "Outlook",
    "Probe",
    "Prober",
    "ProbingSchedule",
    "Rejected",
    "Standing",
    "barrier",
    "excess",
    "geometry_of",
    "is_of",
    "number_after",
    "probe_of",
    "recorded",
    "run_dry",
    "schedule_of",
    "to_its_end",
]
