"""Probing: when to request a cycle from the control, and whether to use its result."""

from gateway.probing.cycle import End, Held, InForce, NotBegun, Outcome, Probe, Rejected, probe_of
from gateway.probing.prober import Prober
from gateway.probing.schedule import Bulletin, Outlook, ProbingSchedule, Standing
from gateway.probing.uninterrupted import to_its_end

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
    "probe_of",
    "to_its_end",
]
