"""A service of one bus whose file a test changes and reloads, and the file with a bus that is the first of its kind."""

from pathlib import Path

from gateway.config.file import load
from gateway.control.restart.earlier import EarlierRun
from gateway.service.service import Service
from talc.control import Controller
from tests.benches.kept_events import KeptEvents
from tests.benches.service_file import MACHINE, TEXT
from tests.benches.stepped_clock import SteppedClock

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


def service_of(path: Path, kept: KeptEvents, clock: SteppedClock, kind: type[Service] = Service) -> Service:
    path.write_text(TEXT, encoding="utf-8")
    config = load(path)
    return kind(config, clock, kept, EarlierRun(Controller(config.input_names, config.talc)))
