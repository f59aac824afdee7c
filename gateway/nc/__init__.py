"""The link to the numerical control: offsets are bounded, slewed, written under a lease and read back."""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from gateway.nc.boundary import contained_control
    from gateway.nc.build import control_of
    from gateway.nc.link import NcLink
    from gateway.nc.problems import still_wrong
    from gateway.nc.routes import ByErrors
    from gateway.nc.settings import Earlier, Identity, LinkSettings, Listeners
    from gateway.nc.slew import Offsets, Slew, Step, Write
    from gateway.nc.states import NcState, Source
else:
    __getattr__ = on_first_use(
        __name__,
        {
            ".boundary": ("contained_control",),
            ".build": ("control_of",),
            ".link": ("NcLink",),
            ".problems": ("still_wrong",),
            ".routes": ("ByErrors",),
            ".settings": ("Earlier", "Identity", "LinkSettings", "Listeners"),
            ".slew": ("Offsets", "Slew", "Step", "Write"),
            ".states": ("NcState", "Source"),
        },
    )

__all__ = [
    "ByErrors",
    "Earlier",
    "Identity",
    "LinkSettings",
    "Listeners",
    "NcLink",
    "NcState",
    "Offsets",
    "Slew",
    "Source",
    "Step",
    "Write",
    "contained_control",
    "control_of",
    "still_wrong",
]
