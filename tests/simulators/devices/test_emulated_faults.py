"""Every fault that a scenario can inflict on an emulated device, read on its wire by the gateway's acquisition."""

import asyncio
import subprocess
import sys
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from drivers.base import Driver, Quality, Reading, SystemClock
from drivers.build import make_device
from gateway.acquisition.acquisition import Acquisition
from gateway.acquisition.line import Line
from gateway.runtime.clocks import RealClock
from simulators.devices.__main__ import DEVICES, emulate
from simulators.devices.scenario import SWITCHES, NotOfThisDeviceError, Scenario
from tests.benches.emulated_profiles import PROFILES, emulated, options, unit_of
from tests.benches.logger_files import logger_profile
from tests.benches.manual_clock import ManualClock

COMM, BROKEN, STALE = Quality.COMM_FAULT, Quality.SENSOR_FAULT, Quality.STALE
NO_FRAME = "no valid answer"
ROWS = [
    ("m7015", "silent = true", "silent = false", COMM, "did not answer within"),
    ("can_logger", "silent = true", "silent = false", COMM, "none of the frames 0x300"),
    *((device, "delay_s = 0.4", "delay_s = 0", COMM, "did not answer within") for device in ("m7015", "adam6015")),
    ("cia404", "delay_s = 0.4", "delay_s = 0", COMM, "node 1: no answer within"),
    ("me_rs485", "delay_s = 0.4", "delay_s = 0", COMM, "did not answer within"),
    ("m7015", "truncated = true", "truncated = false", COMM, NO_FRAME),
    ("adam6015", "truncated = true", "truncated = false", COMM, "not a complete Modbus TCP answer"),
    ("cia404", "truncated = true", "truncated = false", COMM, "node 1: no answer within"),
    ("can_logger", "truncated = true", "truncated = false", COMM, "frame of 4 bytes"),
    ("me_dt6120", "truncated = true", "truncated = false", COMM, NO_FRAME),
    ("me_ethernet", "truncated = true", "truncated = false", COMM, "no complete block"),
    ("m7015", "crc = true", "crc = false", COMM, NO_FRAME),
    ("me_rs485", "crc = true", "crc = false", COMM, NO_FRAME),
    *((device, "exception = 6", "exception = 0", COMM, "device busy") for device in ("pta8d08", "wago464")),
    ("cia404", "abort = 0x06020000", "abort = 0", COMM, "node 1 refused object"),
    ("cia404", "heartbeat = false", "heartbeat = true", STALE, "heartbeat stopped"),
    ("cia404", "silent = true", "reboot = true", COMM, "node 1: no answer within"),
    (
        "cia404",
        'emcy = 0x5000\nfault = "open"\nchannel = 0',
        "emcy = 0\nmend = 0",
        BROKEN,
        "the node reports emergency 0x5000, error register 0x01",
    ),
]
"""Device, what happens to it, what ends that, and what the reading then says."""


def scenario_of(device: str, *entries: str) -> Scenario:
    """The first entry comes at 10 s, the next at 20 s."""
    values = [42.0] * PROFILES[device][1]
    text = f"[[at]]\ns = 0\nvalues = {values}\n"
    return Scenario.parse(text + "".join(f"[[at]]\ns = {10 * n}\n{e}\n" for n, e in enumerate(entries, 1)))


class LatestRead:
    """What was read, the latest last."""

    def __init__(self) -> None:
        self._readings: list[Reading] = []
        self._came = asyncio.Event()

    def take(self, readings: Sequence[Reading]) -> None:
        self._readings.extend(readings)
        self._came.set()

    async def until(self, quality: Quality, says: str = "") -> Reading:
        """The first reading from now on with this quality and this text."""
        self._readings.clear()
        try:
            async with asyncio.timeout(60.0):
                while True:
                    for reading in self._readings:
                        if reading.quality is quality and says in reading.detail:
                            return reading
                    self._came.clear()
                    await self._came.wait()
        except TimeoutError:
            told = {f"{reading.quality}: {reading.detail}" for reading in self._readings}
            raise AssertionError(f"no {quality} with {says!r}; read: {told}") from None


@asynccontextmanager
async def read(device: str, scenario: Scenario, clock: ManualClock, folder: Path) -> AsyncIterator[LatestRead]:
    """The device on its wire, read twenty times a second; the scenario's time is the clock's."""
    profile = logger_profile(folder) if device == "can_logger" else PROFILES[device][0]
    channel = 3 if device == "can_logger" else 0  # at the end of its frame
    heard, unit = LatestRead(), unit_of(device)
    async with emulated(device, scenario, clock, timeout_s=0.2) as bus:
        driver: Driver = make_device("device", bus, profile, unit, {"a": channel}, options(device), SystemClock())
        line = Line(bus, (driver,), period_s=0.05, retry_max_periods=2)
        async with Acquisition([line], RealClock(), heard.take, lambda _: None):
            yield heard


@pytest.mark.simulated_time
@pytest.mark.parametrize(("device", "begin", "end", "quality", "says"), ROWS)
async def test_a_fault_of_the_scenario_is_seen_on_the_wire_and_ends(
    device: str, begin: str, end: str, quality: Quality, says: str, tmp_path: Path
) -> None:
    clock = ManualClock()
    async with read(device, scenario_of(device, begin, end), clock, tmp_path) as heard:
        await heard.until(Quality.GOOD)
        await asyncio.sleep(3.0)  # a heartbeat has come: only then it can stop
        clock.move_to(10.0)
        await heard.until(quality, says)
        clock.move_to(20.0)
        good = await heard.until(Quality.GOOD)
    assert good.value == pytest.approx(42.0, abs=0.06)


@pytest.mark.simulated_time
@pytest.mark.parametrize(
    ("device", "back", "says", "right"),
    [
        ("m7015", "silent = false", "type code 0x0FFF at input 0", 0x2E),
        ("adam6015", "silent = false", "type code 0x0FFF at input 0", 0x03A4),
        ("cia404", "reboot = true", "sensor type 4095 at input 0", 30),
    ],
)
async def test_a_type_code_of_the_scenario_is_noticed_when_the_device_comes_back(
    device: str, back: str, says: str, right: int, tmp_path: Path
) -> None:
    clock, other = ManualClock(), "silent = true\ntype_code = 0x0FFF\nchannel = 0"
    scenario = scenario_of(device, other, back, f"type_code = {right}\nchannel = 0")
    async with read(device, scenario, clock, tmp_path) as heard:
        await heard.until(Quality.GOOD)
        clock.move_to(10.0)
        await heard.until(COMM)
        clock.move_to(20.0)
        await heard.until(COMM, says)
        clock.move_to(30.0)
        await heard.until(Quality.GOOD)


def test_every_switch_is_seen_on_a_wire() -> None:
    lines = [line for _, begin, end, *_ in ROWS for line in f"{begin}\n{end}".splitlines()]
    assert {line.split(" = ")[0] for line in lines} >= SWITCHES.keys()


@pytest.mark.parametrize("device", DEVICES)
async def test_what_cannot_happen_to_a_device_is_named(device: str) -> None:
    has = {
        "m7015": {"crc", "exception", "type_code"},
        "pta8d08": {"crc", "exception"},
        "voltage_input": {"crc", "exception"},
        "adam6015": {"exception", "type_code"},
        "wago464": {"exception"},
        "cia404": {"abort", "emcy", "heartbeat", "reboot", "type_code"},
        "can_logger": set(),
        "me_rs485": {"crc"},
        "me_dt6120": {"crc"},
        "me_ethernet": set(),
    }[device] | {"silent", "delay_s", "truncated", "fault"}
    entries = {
        "type_code": "type_code = 1\nchannel = 0",
        "crc": "crc = true",
        "exception": "exception = 1",
        "abort": "abort = 1",
        "emcy": "emcy = 1",
        "heartbeat": "heartbeat = false",
        "reboot": "reboot = true",
    }
    for key in entries.keys() - has:
        with pytest.raises(NotOfThisDeviceError, match=rf"at\[1\].{key}: {device} .*silent"):
            await emulate(device, scenario_of(device, entries[key]), 1, lambda _: None, asyncio.Event())


def test_program_names_what_cannot_happen_to_its_device(tmp_path: Path) -> None:
    (tmp_path / "scenario.toml").write_text("[[at]]\ns = 0\nvalues = [20, 20, 20, 20, 20, 20]\nreboot = true\n")
    command = [sys.executable, "-m", "simulators.devices", "m7015", str(tmp_path / "scenario.toml")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 2
    assert "scenario.toml: at[0].reboot: m7015 cannot have this; possible: crc, delay_s, exception," in done.stderr
