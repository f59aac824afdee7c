"""Probing: when to request a cycle from the control, and whether to use its result."""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from gateway.probing.cycle import End, Held, InForce, NotBegun, Outcome, Probe, Rejected, probe_of
    from gateway.probing.prober import Prober
    from gateway.probing.schedule import Bulletin, Outlook, ProbingSchedule, excess, schedule_of
    from gateway.probing.standing import Standing
    from gateway.probing.uninterrupted import to_its_end
else:
    __getattr__ = on_first_use(
        __name__,
        {
            ".cycle": ("End", "Held", "InForce", "NotBegun", "Outcome", "Probe", "Rejected", "probe_of"),
            ".prober": ("Prober",),
            ".schedule": ("Bulletin", "Outlook", "ProbingSchedule", "excess", "schedule_of"),
            ".standing": ("Standing",),
            ".uninterrupted": ("to_its_end",),
        },
    )

__all__ = [
    "Bulletin",
    "End",
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
    "excess",
    "probe_of",
    "schedule_of",
    "to_its_end",
]
