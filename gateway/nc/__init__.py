"""The link to the numerical control: offsets are bounded, slewed, written under a lease and read back."""

from gateway.nc.boundary import contained_control
from gateway.nc.build import control_of
from gateway.nc.link import NcLink
from gateway.nc.routes import Form, form_of
from gateway.nc.settings import Earlier, Identity, LinkSettings, Listeners
from gateway.nc.slew import Offsets, Slew, Source, Step, Write
from gateway.nc.states import NcState

__all__ = [
    "Earlier",
    "Form",
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
    "form_of",
]
