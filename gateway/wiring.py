"""From the configuration to drivers. Validates everything that drivers validate; never touches the network."""

from dataclasses import replace
from typing import assert_never

from drivers.base import SetupError
from drivers.build import make_bus, make_device
from drivers.sinumerik_settings import Paths, SinumerikSettings
from gateway.acquisition import Line
from gateway.clock import ServiceClock
from gateway.config import GatewayConfig
from gateway.config.buses import Bus, CanBus, CanopenBus, MeEthernetBus, MeRs485Bus, ModbusRtuBus, ModbusTcpBus
from gateway.config.sections import SinumerikNc

_PARITY = {"none": "N", "even": "E", "odd": "O"}


def lines_of(config: GatewayConfig, clock: ServiceClock) -> tuple[Line, ...]:
    """Every bus with its devices. Raises SetupError naming bus, device, channel and value."""
    lines = []
    for section in config.buses:
        bus = make_bus(section.name, section.kind, _options(section))
        drivers = tuple(
            make_device(
                device.name,
                bus,
                device.profile,
                device.unit,
                {name: _number(device.name, name, channel) for name, channel in device.channels.items()},
                device.options,
                clock,
            )
            for device in config.devices_of(section.name)
        )
        lines.append(Line(bus, drivers, section.period_s, section.retry_max_periods, section.read_limit_s))
    return tuple(lines)


def sinumerik_settings(nc: SinumerikNc, poses: int) -> SinumerikSettings:
    """The NC driver's settings. Raises SetupError naming the field and the value."""
    known = set(Paths.__dataclass_fields__)
    for name in nc.nodes:
        if name not in known:
            raise SetupError(f"[nc.nodes] {name} is unknown", hint=f"there are {', '.join(sorted(known))}")
    standard = SinumerikSettings(url=nc.url)
    return replace(
        standard,
        timeout_s=nc.timeout_s,
        security=nc.security,
        user=nc.user or "",
        password_file=nc.password_file,
        certificate=nc.certificate,
        private_key=nc.private_key,
        paths=replace(standard.paths, **dict(nc.nodes)),  # type: ignore[arg-type]
        handshake=replace(standard.handshake, poses=poses),
    )


def _options(bus: Bus) -> dict[str, object]:
    """The fields of the driver's settings class."""
    common: dict[str, object] = {"timeout_s": bus.timeout_s}
    match bus:
        case ModbusRtuBus() | MeRs485Bus():
            return common | {
                "port": bus.port,
                "baud": bus.baud,
                "parity": _PARITY[bus.parity],
                "stopbits": bus.stop_bits,
            }
        case ModbusTcpBus() | MeEthernetBus():
            return common | {"host": bus.host, "port": bus.port}
        case CanopenBus() | CanBus():
            return common | {"interface": bus.interface, "channel": bus.channel, "bitrate": bus.bitrate}
        case _:
            assert_never(bus)


def _number(device: str, name: str, channel: int | str) -> int:
    if isinstance(channel, str):
        raise SetupError(f"channel = {channel!r}: expected a number", device=device, channel=name)
    return channel
