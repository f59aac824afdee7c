"""From the configuration to the driver of the numerical control. Never touches the network."""

from typing import assert_never

from drivers.linuxcnc.control import LinuxCnc
from drivers.nc import NumericalControl
from gateway.clock import ServiceClock
from gateway.config import GatewayConfig
from gateway.config.controls import LinuxCncNc, Nc, SinumerikNc


def control_of(nc: Nc, config: GatewayConfig, clock: ServiceClock) -> NumericalControl:
    """The driver of the numerical control. Raises SetupError naming the field and the value."""
    poses = len(config.probing.poses_deg)
    match nc:
        case SinumerikNc():
            # OPC UA takes half a second and 20 MB: only where such a control is.
            from drivers.sinumerik.control import Sinumerik
            from drivers.sinumerik.slope import SinumerikWithSlopes

            settings = nc.settings(poses, (state.name for state in config.states))
            kind = SinumerikWithSlopes if settings.compensation.route == "k0_slope" else Sinumerik
            return kind(settings, clock)
        case LinuxCncNc():
            return LinuxCnc(nc.settings(poses, ()), clock)
        case _:
            assert_never(nc)
