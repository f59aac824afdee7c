"""`run`, `probe`, `probe --watch` and `scan` read a device alike, and call the same value the same quality."""

import asyncio
import re
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from math import isnan
from pathlib import Path

import pytest

from drivers.base import Quality, Reading
from gateway.acquisition.acquisition import Acquisition
from gateway.acquisition.build import lines_of
from gateway.commissioning.scan.found import ScanReport
from gateway.commissioning.scan.tcp import TcpScan, scan_hosts
from gateway.config.file import load
from gateway.runtime.clocks import RealClock
from simulators.devices import M7015, Adam6015, Cia404Node, RtuLine, SlcanAdapter, TcpHost
from simulators.devices.pta8d08 import Pta8d08
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


@asynccontextmanager
async def served(wire: RtuLine | SlcanAdapter) -> AsyncIterator[str]:
    try:
        yield await wire.start()
    finally:
        await wire.stop()


def of_reading(reading: Reading) -> tuple[str, Quality]:
    return "" if isnan(reading.value) else f"{reading.value:.2f}", reading.quality


def of_text(text: str) -> tuple[str, Quality]:
    """`20.00`, `80.00(out_of_range)` or `sensor_fault`."""
    found = re.fullmatch(r"(-?[\d.]*)\(?(\w*)\)?", text)
    assert found, text
    return found[1], Quality(found[2] or "good")


async def run(file: Path, ends: Callable[[Reading], bool] = lambda _: True) -> ShownValues:
    """What the service takes: its acquisition's latest readings, when it has all and the last one `ends` it."""
    taken: dict[str, Reading] = {}
    complete = asyncio.Event()

    def take(readings: Sequence[Reading]) -> None:
        for reading in readings if not complete.is_set() else ():
            taken[reading.channel] = reading
        if len(taken) == len(channels) and ends(readings[-1]):
            complete.set()

    config = load(file)
    channels = [channel.name for channel in config.channels]
    async with Acquisition(lines_of(config, RealClock()), RealClock(), take, lambda _: None), asyncio.timeout(60.0):
        await complete.wait()
    return {channel: of_reading(taken[channel]) for channel in channels}


def probe(file: Path) -> ShownValues:
    rows = [[cell.strip() for cell in line.split("│")] for line in here("probe", str(file)).out.splitlines()]
    return {row[3]: (row[4].removesuffix(" degC"), Quality(row[5])) for row in rows if len(row) == 8}


def probe_watch(file: Path, seconds: int = 2) -> ShownValues:
    done = here("probe", str(file), "--watch", "--seconds", seconds, "--every", "1")
    return {channel: of_text(text) for channel, text in re.findall(r"(\w+)=(\S+)", done.out)}


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


@asynccontextmanager
async def hanging_adam() -> AsyncIterator[int]:
    """The same module; a second and a bit after its first answer, each answer takes a minute."""
    answered_s = list[float]()

    def spoil(_: int, frame: bytes) -> Sequence[tuple[float, bytes]]:
        answered_s.append(asyncio.get_running_loop().time())
        return ((60.0 if answered_s[-1] - answered_s[0] > 1.2 else 0.0, frame),)

    module = Adam6015(lambda: [20.0, 30.0, 80.0, 40.0, 0.0, 0.0, 0.0])
    module.faults.set(1, SensorFault.OPEN)
    host = TcpHost({1: module})
    host.spoil = spoil
    try:
        yield await host.start()
    finally:
        await host.stop()


def test_a_read_that_hangs(tmp_path: Path) -> None:
    """Three periods after its last value a channel is stale, whatever reads it."""
    file = tmp_path / "gateway.toml"

    def hanging(port: int) -> Path:
        file.write_text(CONFIG.format(port=port, timeout_s=9.0), encoding="utf-8")
        return file

    with beside(hanging_adam()) as port:
        taken = asyncio.run(run(hanging(port), ends=lambda reading: reading.quality is Quality.STALE))
    with beside(hanging_adam()) as port:
        watched = probe_watch(hanging(port), seconds=5)
    with beside(hanging_adam()) as port:
        recorded = here("record", hanging(port), "-o", tmp_path / "field.wire", "--seconds", 5)
    assert taken == {
        "bed": ("", Quality.STALE),
        "column": ("", Quality.SENSOR_FAULT),  # a bad value does not go stale
        "oil": ("80.00", Quality.OUT_OF_RANGE),
        "hall": ("", Quality.STALE),
    }
    assert watched == taken
    assert "4 channels not good at the end" in recorded.err


@pytest.mark.slow
def test_devices_of_two_wires_from_the_scan_that_found_them_to_the_service(tmp_path: Path) -> None:
    """At 600 baud, which a configuration once refused. Each command reads with what `scan` wrote."""
    file = tmp_path / "gateway.toml"
    module = M7015(lambda: [20.0, 30.0, 40.0, 50.0, 60.0, 70.0])
    module.faults.set(2, SensorFault.OPEN)
    node = Cia404Node(5, lambda: [20.0, 30.0, 40.0, 999.0], inputs=4, vendor="esd")
    node.faults.set(1, SensorFault.OPEN)
    line = RtuLine({1: module, 2: Pta8d08(lambda: [20.0, 99.96, 22.0, 23.0, 24.0, 25.0, 26.0, 27.0])}, baud=600)
    speeds = ("--protocol", "modbus_rtu", "--units", "1,2", "--baud", "1200", "--baud", "600")
    with beside(served(line)) as port, beside(served(SlcanAdapter([node], bitrate=125_000))) as adapter:
        found = here("scan", "serial", port, *speeds, "--toml", str(file)).out
        can = ("scan", "can", adapter, "--interface", "slcan", "--bitrate", "125000")
        found += here(*can, "--toml", str(file), answer="y\n").out
        checked = here("check", str(file))
        taken, probed, watched = asyncio.run(run(file)), probe(file), probe_watch(file)
    assert checked.code == 0, checked.out
    scanned = [text for row in re.findall(r"│ +│ +│ +│ ([^│]*) degC +│", found) for text in row.split()]
    assert dict(zip(taken, map(of_text, scanned), strict=True)) == taken
    assert probed == watched == taken
    assert {channel: shown for channel, shown in taken.items() if shown[1] is not Quality.GOOD} == {
        "rtd1_in2": ("", Quality.SENSOR_FAULT),
        "rtd2_in1": ("", Quality.OUT_OF_RANGE),
        "rtd3_in1": ("", Quality.SENSOR_FAULT),
        "rtd3_in3": ("", Quality.OUT_OF_RANGE),
    }
