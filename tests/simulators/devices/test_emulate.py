"""Every emulated device started by name, driven by a scenario and read by the driver of the gateway."""

import asyncio
import signal
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from drivers.base import Quality, Reading, SystemClock
from drivers.build import make_device
from drivers.modbus.bus import ModbusBus
from drivers.profiles import load_profile
from drivers.recognition import recognise_modbus
from simulators.devices.__main__ import DEVICES, emulate
from simulators.devices.scenario import Scenario
from tests.benches.emulated_profiles import PROFILES, emulated, options, unit_of
from tests.benches.logger_files import logger_profile

SCENARIO = """
[[at]]
s = 0
values = {}
[[at]]
s = 0.3
fault = "over"
channel = 0
[[at]]
s = 1.3
mend = 0
"""


STEADY = "[[at]]\ns = 0\nvalues = {}\n"


@pytest.mark.simulated_time
@pytest.mark.parametrize("device", DEVICES)
async def test_device_plays_its_scenario(device: str, tmp_path: Path) -> None:
    profile, inputs = PROFILES[device]
    if device == "can_logger":
        profile = logger_profile(tmp_path)
    scenario = Scenario.parse(SCENARIO.format([42.0] * inputs))
    seen: list[Reading] = []
    async with emulated(device, scenario) as bus, asyncio.timeout(60.0):
        driver = make_device("device", bus, profile, unit_of(device), {"a": 0}, options(device), SystemClock())
        await bus.connect()
        await driver.connect()
        while len(seen) < 3:
            (reading,) = await driver.read()
            if not seen or (reading.quality is Quality.GOOD) != (seen[-1].quality is Quality.GOOD):
                seen.append(reading)
            await asyncio.sleep(0.01)
    assert [reading.quality is Quality.GOOD for reading in seen] == [True, False, True]
    assert [seen[0].value, seen[2].value] == pytest.approx([42.0, 42.0], abs=0.06)


@pytest.mark.simulated_time
@pytest.mark.parametrize("device", ["m7015", "pta8d08", "adam6015", "wago464"])
async def test_scan_recognises_it(device: str) -> None:
    profile, inputs = PROFILES[device]
    async with emulated(device, Scenario.parse(STEADY.format([42.0] * inputs))) as bus:
        await bus.connect()
        assert isinstance(bus, ModbusBus)
        what = await recognise_modbus(bus, 1)
    assert (what.profile, what.doubts) == (profile, ())


@pytest.mark.simulated_time
@pytest.mark.parametrize("device", DEVICES)
async def test_every_possible_number_of_inputs_is_answered_and_no_other_begins(device: str) -> None:
    profile, what = PROFILES[device][0], DEVICES[device]
    for inputs in {what.least, what.most} if profile else ():  # how many a logger sends is up to its DBC file
        scenario = Scenario.parse(STEADY.format([42.0] * inputs))
        last = {"last": min(inputs, load_profile(profile).channels) - 1}
        async with emulated(device, scenario) as bus:
            driver = make_device("device", bus, profile, unit_of(device), last, options(device), SystemClock())
            await bus.connect()
            await driver.connect()
            assert [r.quality for r in await driver.read()] == [Quality.GOOD]
    for inputs in {what.least - 1, what.most + 1} - {0}:
        scenario = Scenario.parse(STEADY.format([42.0] * inputs))
        with pytest.raises(ValueError, match=f"has {inputs} entries, but {device} has {what.least}.* inputs"):
            await emulate(device, scenario, 1, lambda _: None, asyncio.Event())


def test_program_says_where_it_listens_and_ends_when_interrupted(tmp_path: Path) -> None:
    (tmp_path / "scenario.toml").write_text(f"[[at]]\ns = 0\nvalues = {[20.0] * 6}\n")
    command = [sys.executable, "-m", "simulators.devices", "m7015", str(tmp_path / "scenario.toml")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        (bus,) = tomllib.loads("".join(process.stdout.readline() for _ in range(4)))["bus"]
        assert (bus["name"], bus["kind"], bus["port"][:9]) == ("bus1", "modbus_rtu", "/dev/pts/")
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ([], "at[0].values = []: expected numbers"),
        ([20.0] * 8, "scenario.toml: `values` has 8 entries, but adam6015 has 7 inputs"),
    ],
)
def test_program_names_a_mistake_in_the_scenario(values: list[float], says: str, tmp_path: Path) -> None:
    (tmp_path / "scenario.toml").write_text(f"[[at]]\ns = 0\nvalues = {values}\n")
    command = [sys.executable, "-m", "simulators.devices", "adam6015", str(tmp_path / "scenario.toml")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 2
    assert says in done.stderr
