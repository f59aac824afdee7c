"""From the configuration to drivers. Validates everything that drivers validate; never touches the network."""

from collections.abc import Callable
from typing import assert_never

from drivers.build import bus_from_settings, make_device
from drivers.linuxcnc.control import LinuxCnc
from drivers.nc import NumericalControl
from drivers.tap import Tap
from gateway.acquisition.plausibility import Plausible
from gateway.acquisition.runner import Line
from gateway.clock import ServiceClock
from gateway.config import GatewayConfig
from gateway.config.controls import LinuxCncNc, Nc, SinumerikNc


def lines_of(config: GatewayConfig, clock: ServiceClock, tap: Callable[[str], Tap] | None = None) -> tuple[Line, ...]:
    """Every bus with its devices. Raises SetupError naming bus, device, channel and value.

    tap: gives who listens in on the bus of that name
    """
    plausible = {
        name: Plausible(
            smallest=limits.min,
            largest=limits.max,
            jump=limits.max_jump,
            rate_per_min=limits.max_rate_per_min,
            stuck_after_s=limits.stuck_after_s,
        )
        for name, limits in config.limits.items()
    }
    lines: list[Line] = []
    for section in config.buses:
        bus = bus_from_settings(section.name, section, None if tap is None else tap(section.name))
        drivers = tuple(
            make_device(
                device.name,
                bus,
                device.profile,
                device.unit,
                device.channels,
                device.options,
                clock,
            )
            for device in config.devices_of(section.name)
        )
        lines.append(
            Line(
                bus,
                drivers,
                section.period_s,
                section.retry_max_periods,
                section.read_limit_s,
                plausible,
                # Spread over the period: twenty buses at one instant would wait for each other, and all meet a hiccup.
                phase_s=section.period_s * len(lines) / len(config.buses),
            )
        )
    return tuple(lines)


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
