"""Clocks of the service, whether they are known to be right, and how long ago something was across a restart."""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from gateway.clock.ages import Ages, StepTime
    from gateway.clock.clocks import RealClock, ServiceClock
    from gateway.clock.time_service import clock_synchronised
else:
    __getattr__ = on_first_use(
        __name__,
        {
            ".ages": ("Ages", "StepTime"),
            ".clocks": ("RealClock", "ServiceClock"),
            ".time_service": ("clock_synchronised",),
        },
    )

__all__ = ["Ages", "RealClock", "ServiceClock", "StepTime", "clock_synchronised"]
