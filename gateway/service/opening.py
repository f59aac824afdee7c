"""Log lines of a gateway's start: version, wires, mode, store, endpoints, control, what is not armed."""

from collections.abc import Iterator
from importlib.metadata import version

from gateway.config.consequences import unarmed
from gateway.config.model import GatewayConfig
from gateway.model.codes import NoticeCode
from gateway.model.text import Text
from gateway.runtime.terminal import counted
from gateway.telemetry import keys


def contents(config: GatewayConfig) -> str:
    """The numbers of buses, devices, channels and machine states of the configuration."""
    return (
        f"{counted(len(config.buses), 'bus', 'buses')}, {counted(len(config.devices), 'device')}, "
        f"{counted(len(config.channels), 'channel')}, {counted(len(config.states), 'machine state')}"
    )


def armed(config: GatewayConfig) -> Text:
    """Whether anything is written to the control."""
    code = NoticeCode.MODE_AND_PROBING if config.probing.armed else NoticeCode.MODE_WITHOUT_PROBING
    return Text(code, mode=config.compensation.mode)


def opening(config: GatewayConfig) -> Iterator[str]:
    """Lines for the log at the start and after a reload."""
    yield (
        f"talc-gateway {version('talc-gateway')} runs machine {config.machine.name}, configuration "
        f"{config.fingerprint()[:16]}: {contents(config)}"
    )
    for bus in config.buses:
        channels = sum(len(device.channels) for device in config.devices_of(bus.name))
        yield f"bus {bus.name}: {bus.kind} at {bus.place}, {counted(channels, 'channel')} every {bus.period_s:g} s"
    control = "none" if config.nc is None else f"{config.nc.kind} at {config.nc.address}"
    yield f"control: {control}; {armed(config)}"
    telemetry = config.telemetry
    if telemetry.enabled:
        places = [f"listening on {place.text}" for place in telemetry.listening]
        places += [f"connecting to {place}" for place in telemetry.connect]
        root = keys.root(telemetry.prefix, config.machine.name)
        yield f"store: {config.storage.path}; published as {root}/**, {', '.join(places) or 'no endpoint'}"
    else:
        yield f"store: {config.storage.path}"
    metrics = config.metrics
    if metrics.listen is not None:
        yield f"metrics: {'https' if metrics.tls else 'http'}://{metrics.listen}/metrics"
    yield from unarmed(config)
