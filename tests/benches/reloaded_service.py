"""Services without an earlier run; one of one bus whose file a test changes; a bus that is the first of its kind."""

from pathlib import Path

from gateway.config.file import load
from gateway.config.model import GatewayConfig
from gateway.control.restart.earlier import EarlierRun
from gateway.control.sensor_watch import SeenBefore
from gateway.runtime.clocks import ServiceClock
from gateway.service.service import Service
from talc.control import Controller
from tests.benches.kept_events import KeptEvents
from tests.benches.service_file import MACHINE, TEXT

OF_A_NEW_KIND = (
    MACHINE
    + """
[[bus]]
name = "can1"
kind = "canopen"
channel = "vcan9"
[[device]]
name = "jumo"
bus = "can1"
profile = "cia404"
unit = 5
channels = { bed_front = 0 }
options = { vendor = "jumo" }
"""
)


def service_of(
    config: GatewayConfig,
    kept: KeptEvents,
    clock: ServiceClock,
    kind: type[Service] = Service,
    seen: SeenBefore | None = None,
) -> Service:
    """One that has learnt nothing yet."""
    return kind(config, clock, kept, EarlierRun(Controller(config.input_names, config.talc), seen=seen))


def service_of_file(path: Path, kept: KeptEvents, clock: ServiceClock, kind: type[Service] = Service) -> Service:
    """Of the file, which is written."""
    path.write_text(TEXT, encoding="utf-8")
    return service_of(load(path), kept, clock, kind)
