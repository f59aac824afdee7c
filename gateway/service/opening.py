"""Log lines of a gateway's start: version, wires, mode, store, endpoints, control, what is not armed."""

from collections.abc import Iterator

from gateway.config.consequences import unarmed
from gateway.config.model import GatewayConfig
from gateway.model.codes import NoticeCode
from gateway.model.text import Text
from gateway.runtime.versions import program_version
from gateway.telemetry import keys


def contents(config: GatewayConfig) -> Text:
    """The numbers of buses, devices, channels and machine states of the configuration."""
    return Text(
        NoticeCode.CONTENTS,
        buses=len(config.buses),
        devices=len(config.devices),
        channels=len(config.channels),
        states=len(config.states),
    )


def armed(config: GatewayConfig) -> Text:
    """Whether anything is written to the control."""
    code = NoticeCode.MODE_AND_PROBING if config.probing.armed else NoticeCode.MODE_WITHOUT_PROBING
    return Text(code, mode=config.compensation.mode)


def opening(config: GatewayConfig) -> Iterator[Text]:
    """Lines for the log at the start and after a reload."""
    yield Text(
        NoticeCode.MACHINE_RUNS,
        version=program_version(),
        machine=config.machine.name,
        fingerprint=config.fingerprint()[:16],
        contents=contents(config),
    )
    for bus in config.buses:
        channels = sum(len(device.channels) for device in config.devices_of(bus.name))
        yield Text(
            NoticeCode.BUS_AT, bus=bus.name, kind=bus.kind, place=bus.place, channels=channels, period_s=bus.period_s
        )
    if config.nc is None:
        yield Text(NoticeCode.CONTROL_NONE, armed=armed(config))
    else:
        yield Text(NoticeCode.CONTROL_AT, kind=config.nc.kind, place=config.nc.address, armed=armed(config))
    telemetry, store = config.telemetry, str(config.storage.path)
    if telemetry.enabled:
        places = [Text(NoticeCode.LISTENING_ON, place=place.text) for place in telemetry.listening]
        places += [Text(NoticeCode.CONNECTING_TO, place=place) for place in telemetry.connect]
        root = keys.root(telemetry.prefix, config.machine.name)
        yield Text(NoticeCode.STORE_PUBLISHED, store=store, key=f"{root}/**", places=places or "no endpoint")
    else:
        yield Text(NoticeCode.STORE_AT, store=store)
    metrics = config.metrics
    if metrics.listen is not None:
        url = f"{'https' if metrics.tls else 'http'}://{metrics.listen}/metrics"
        yield Text(NoticeCode.METRICS_AT, url=url)
    yield from unarmed(config)
