"""Builds the driver of the numerical control from the configuration. Never uses the network."""

from typing import assert_never

from drivers.agent.control import AgentControl
from drivers.mtconnect.make import make_mtconnect
from drivers.nc import NumericalControl
from drivers.sinumerik.make import make_sinumerik
from gateway.config.controls import AgentNc, LinuxCncNc, MtConnectNc, Nc, SinumerikNc
from gateway.config.extensions import ControlSection
from gateway.config.model import GatewayConfig
from gateway.runtime.clocks import ServiceClock


def control_of(nc: Nc, config: GatewayConfig, clock: ServiceClock, *, dry: bool = False) -> NumericalControl:
    """The driver of the numerical control. Raises SetupError naming the field and the value.

    dry: for a dry run, which is asked for before anything is armed, and writes no offsets
    """
    poses = config.probing.poses_deg
    match nc:
        case SinumerikNc():
            asks, writes = config.probing.armed or dry, config.compensation.mode == "compensate" and not dry
            names = (state.name for state in config.states)
            settings = nc.settings(poses, names, asks=asks, writes=writes, watchdog_s=config.compensation.watchdog_s)
            return make_sinumerik(settings, clock)
        case AgentNc() | LinuxCncNc():
            return AgentControl(nc.settings(poses, ()), clock)
        case MtConnectNc():
            return make_mtconnect(nc.settings(poses, (state.name for state in config.states)), clock)
        case ControlSection():
            return nc.built(poses, (state.name for state in config.states), clock)
        case _:
            assert_never(nc)
