"""HAL pins and signals of the real LinuxCNC as channels, beside the gateway's connection that writes offsets.

Needs Debian's linuxcnc-uspace.
"""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from drivers.base import Driver, Quality, SystemClock, WrongDevice
from drivers.build import make_device
from drivers.nc import WatchdogTerms
from tests.benches.buses import make_bus
from tests.benches.driver_reads import told
from tests.benches.linuxcnc_bench import ANSWER_S, AgentBench, claimed, running, until

pytestmark = pytest.mark.peer

PROFILE = """
protocol = "agent"
title = "what LinuxCNC knows"
unit = "degC"
max_age_s = 3600
[[value]]
name = "drive-x.value"
high = 120.0
[[value]]
name = "spindle-temperature"
scale = 0.1
[[value]]
name = "spindle-load"
unit = "%"
[[value]]
name = "drive-y.value"
[[value]]
name = "drive-x.value"
alive = "readings"
"""
COUNT = 5


@asynccontextmanager
async def device_of(bench: AgentBench, folder: Path, text: str, count: int) -> AsyncIterator[Driver]:
    """Its bus connected; the device not yet."""
    path = folder / "pins.toml"
    path.write_text(text)
    given = {"port": bench.settings.port, "key_file": str(bench.settings.key_file), "timeout_s": ANSWER_S}
    bus = make_bus("nc1", "agent", given)
    device = make_device("pins", bus, str(path), 1, {f"c{i}": i for i in range(count)}, {}, SystemClock())
    await bus.connect()
    try:
        yield device
    finally:
        await bus.close()


async def test_pins_and_signals_are_channels_beside_the_gateway_that_writes(tmp_path: Path) -> None:
    async with running(tmp_path, {}) as bench:
        hal = bench.operator
        await hal.ask("hal", "loadrt", "constant", "names=drive-x")
        await hal.ask("hal", "setp", "drive-x.value", "61.25")
        for name, kind, value in (
            ("spindle-temperature", "s32", "385"),
            ("spindle-load", "float", "nan"),
            ("readings", "u32", "7"),
        ):
            await hal.ask("hal", "newsig", name, kind)
            await hal.ask("hal", "sets", name, value)
        await claimed(bench, WatchdogTerms(silence_s=60.0, ramp_um_per_s=1.0))
        async with bench.beating(7), device_of(bench, tmp_path, PROFILE, COUNT) as device:
            await device.connect()
            warm, spindle, load, absent, counted = told(await device.read())
            assert warm == (61.25, "degC")
            assert spindle == (38.5, "degC")
            assert load == ("sensor_fault", "spindle-load holds no finite number: nan")
            assert absent[0] == "comm_fault"
            assert absent[1].startswith("the control has nothing named drive-y.value: compare the name")
            assert counted == ("stale", "readings has not changed since the gateway began to read it")

            await hal.ask("hal", "sets", "readings", "8")
            await hal.ask("hal", "setp", "drive-x.value", "121")
            warm, *_, counted = told(await device.read())
            assert warm == ("out_of_range", "121 is beyond the profile's limits")
            assert counted == (121.0, "degC")

            await bench.nc.write_compensation((1.0, 2.0, -3.0))
            assert await bench.nc.heartbeat(7), "the connection that writes was never disturbed"

        nothing = PROFILE.split("[[value]]")[0] + '[[value]]\nname = "drive-Y.value"\n'
        async with device_of(bench, tmp_path, nothing, 1) as stranger:
            with pytest.raises(
                WrongDevice, match=r"bus nc1, device pins: the control has nothing named drive-Y\.value"
            ):
                await stranger.connect()


async def test_values_of_a_control_that_stands_still_are_stale(tmp_path: Path) -> None:
    async with running(tmp_path, {}) as bench:
        only = PROFILE.split("[[value]]")[0] + '[[value]]\nname = "motion.servo.last-period"\nunit = "1"\n'
        async with device_of(bench, tmp_path, only, 1) as device:
            await device.connect()

            async def good() -> bool:
                return (await device.read())[0].quality is Quality.GOOD

            async def stale() -> bool:
                return (await device.read())[0].quality is Quality.STALE

            assert await good()
            for part in ("milltask", "rtapi_app"):
                await bench.operator.ask("freeze", part)
                await until(stale)
                assert told(await device.read()) == [("stale", "LinuxCNC does not run, or its state does not change")]
                await bench.operator.ask("thaw", part)
                await until(good)
