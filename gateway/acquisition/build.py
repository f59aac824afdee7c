"""Builds drivers from the configuration. Validates everything that drivers validate; never uses the network."""

from collections.abc import Callable, Collection

from drivers.tap import Tap
from gateway.acquisition.line import Line
from gateway.config.model import GatewayConfig
from gateway.runtime.clocks import ServiceClock

_APART_S = 0.01
"""Time from the beginning of one bus's periods to the beginning of the next bus's. Buses that begin at one instant wait
for each other. Far apart, each needs more processor time, as its code and data are no longer in the processor's
caches."""


def lines_of(
    config: GatewayConfig,
    clock: ServiceClock,
    tap: Callable[[str], Tap] | None = None,
    only: Collection[str] | None = None,
) -> tuple[Line, ...]:
    """Every bus with its devices. Raises SetupError naming bus, device, channel and value.

    tap: returns the tap of the bus with that name, or None
    only: names of the buses to make; None: all
    """
    lines: list[Line] = []
    for number, section in enumerate(config.buses):
        if only is not None and section.name not in only:
            continue
        devices = config.devices_of(section.name)
        bus, drivers = section.built(devices, config.profile_of, None if tap is None else tap(section.name), clock)
        lines.append(
            Line(
                bus,
                drivers,
                section.period_s,
                section.retry_max_periods,
                section.read_limit_s,
                config.limits,
                phase_s=number * min(_APART_S, section.period_s / len(config.buses)),
            )
        )
    return tuple(lines)
