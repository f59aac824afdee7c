"""`run`, `probe`, `probe --watch` and `scan` read a device alike, and call the same value the same quality."""

import asyncio
import re
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from math import isnan
from pathlib import Path

import pytest

from drivers.base import Quality, Reading
from gateway.acquisition.acquisition import Acquisition
from gateway.acquisition.build import lines_of
from gateway.clock import RealClock
from gateway.config import load
from gateway.scan.found import ScanReport
from gateway.scan.tcp import TcpScan, scan_hosts
from simulators.devices import Adam6015, TcpHost
from simulators.devices.source import SensorFault
from tests.benches.command import beside, here

pytestmark = pytest.mark.simulated_time

CONFIG = """[machine]
name = "mill"
[[bus]]
name = "tcp1"
kind = "modbus_tcp"
host = "127.0.0.1"
port = {port}
period_s = 0.5
timeout_s = {timeout_s}
[[device]]
name = "adam"
bus = "tcp1"
profile = "advantech_adam6015"
[device.channels]
bed = 0
column = 1
oil = 2
hall = 3
[limits.oil]
max = 60.0
"""
LIMITED = "oil"
"""The only one that the configuration judges: a scan, which has none, calls it good."""

ShownValues = dict[str, tuple[str, Quality]]
"""Channel to its number, empty when it has none, and its quality."""


@asynccontextmanager
async def adam(*, silent: bool = False) -> AsyncIterator[int]:
    """A module with a good sensor, a broken one, and one beyond its limit; yields its port."""
    module = Adam6015(lambda: [20.0, 30.0, 80.0, 40.0, 0.0, 0.0, 0.0])
    module.faults.set(1, SensorFault.OPEN)
    module.faults.silent = silent
    host = TcpHost({1: module})
    try:
        yield await host.start()
    finally:
        await host.stop()


def of_reading(reading: Reading) -> tuple[str, Quality]:
    return "" if isnan(reading.value) else f"{reading.value:.2f}", reading.quality


def of_text(text: str) -> tuple[str, Quality]:
    """`20.00`, `80.00(out_of_range)` or `sensor_fault`."""
    found = re.fullmatch(r"(-?[\d.]*)\(?(\w*)\)?", text)
    assert found, text
    return found[1], Quality(found[2] or "good")


async def run(file: Path) -> ShownValues:
    """What the service takes: its acquisition's first reading of each channel."""
    taken: dict[str, Reading] = {}
    complete = asyncio.Event()

    def take(readings: Sequence[Reading]) -> None:
        for reading in readings:
            taken.setdefault(reading.channel, reading)
        complete.set()

    async with Acquisition(lines_of(load(file), RealClock()), RealClock(), take, lambda _: None), asyncio.timeout(60.0):
        await complete.wait()
    return {channel: of_reading(reading) for channel, reading in taken.items()}


def probe(file: Path) -> ShownValues:
    rows = re.findall(r"│ adam +│ (\w+) +│ +([\d.]*)[^│]*│ (\w+) +│", here("probe", str(file)).out)
    return {channel: (number, Quality(quality)) for channel, number, quality in rows}


def probe_watch(file: Path) -> ShownValues:
    done = here("probe", str(file), "--watch", "--seconds", "2", "--every", "1")
    last = done.out.splitlines()[-1]
    return {channel: of_text(text) for channel, text in re.findall(r"(\w+)=(\S+)", last)}


async def scan(port: int) -> ScanReport:
    return await scan_hosts(TcpScan((("127.0.0.1", port),), (1,), 5.0), lambda *_: None, lambda: False)


def test_a_good_a_broken_and_a_limited_sensor(tmp_path: Path) -> None:
    file = tmp_path / "gateway.toml"
    with beside(adam()) as port:
        file.write_text(CONFIG.format(port=port, timeout_s=0.5), encoding="utf-8")
        taken, probed, watched = asyncio.run(run(file)), probe(file), probe_watch(file)
        scanned = asyncio.run(scan(port))
    assert taken == {
        "bed": ("20.00", Quality.GOOD),
        "column": ("", Quality.SENSOR_FAULT),
        "oil": ("80.00", Quality.OUT_OF_RANGE),
        "hall": ("40.00", Quality.GOOD),
    }
    assert probed == watched == taken
    (device,) = scanned.found
    texts = device.reads.split()[: len(taken)]
    of_scan = {channel: of_text(text) for channel, text in zip(taken, texts, strict=True)}
    assert of_scan == taken | {LIMITED: ("80.00", Quality.GOOD)}


def test_a_silent_device(tmp_path: Path) -> None:
    file = tmp_path / "gateway.toml"
    with beside(adam(silent=True)) as port:
        file.write_text(CONFIG.format(port=port, timeout_s=0.5), encoding="utf-8")
        taken, probed, watched = asyncio.run(run(file)), probe(file), probe_watch(file)
    assert taken == dict.fromkeys(("bed", "column", "oil", "hall"), ("", Quality.COMM_FAULT))
    assert probed == watched == taken
