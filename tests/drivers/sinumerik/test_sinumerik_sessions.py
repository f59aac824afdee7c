"""Channels of the control beside the session that writes the offsets, and what a hanging read does to that session.

The control's server is the library's (asyncua): like others it answers the requests of one connection in their order.
"""

import asyncio
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from drivers.base import Bus, Driver, NoAnswer, Quality, SystemClock
from drivers.build import make_device
from drivers.nc import WatchdogTerms
from drivers.opcua.session import OpcUaSession
from drivers.sinumerik.control import Sinumerik
from drivers.sinumerik.settings import SinumerikSettings
from gateway.runtime.clocks import RealClock
from simulators.nc import Activity, DayPart, EmulatedControl, LoadCase, MeanLoads
from tests.benches.buses import make_bus
from tests.benches.emulated_bench import Rigid

pytestmark = pytest.mark.simulated_time

SPINDLE, DRIVE = "/Channel/Spindle/actSpeed[u1,1]", "/DriveVsa/Drive/r0035[u1]"
PROFILE = f"""
protocol = "opcua"
title = "drives of the control"
unit = "degC"
namespace = "SinumerikVarProvider"
[[node]]
node = "s={SPINDLE}"
unit = "1/min"
[[node]]
node = "s={DRIVE}"
"""
OWNER, TIMEOUT_S = 7, 0.5


class SlowControl(EmulatedControl):
    """A control whose drives answer only when the test allows it."""

    def __init__(self) -> None:
        program = LoadCase([DayPart(0.0, 1e9, Activity.ROUGHING, MeanLoads(x=60.0))])
        super().__init__(Rigid(), RealClock(), program)
        self.before_read = self._wait
        self.answer = asyncio.Event()
        self.asked = asyncio.Event()
        """Set while a request for a drive is being answered."""

    async def _wait(self, nodes: Sequence[str]) -> None:
        if DRIVE in nodes:
            self.asked.set()
            await self.answer.wait()
            self.asked.clear()


@asynccontextmanager
async def slow_drives() -> AsyncIterator[tuple[SlowControl, str]]:
    control = SlowControl()
    url = await control.start()
    try:
        yield control, url
    finally:
        control.answer.set()
        await control.stop()
        await asyncio.get_running_loop().shutdown_default_executor()


def channels_of(url: str, folder: Path) -> tuple[Bus, list[Driver]]:
    """Two devices of the control's own bus."""
    profile = folder / "control.toml"
    profile.write_text(PROFILE)
    bus = make_bus("control", "opcua", {"url": url, "security": "none", "timeout_s": TIMEOUT_S})
    channels = {"speed": 0, "motor": 1}
    devices = [make_device(name, bus, str(profile), 1, channels, {}, SystemClock()) for name in ("first", "second")]
    return bus, devices


async def test_a_reading_that_hangs_delays_no_beat_and_ends_no_session_but_its_own(tmp_path: Path) -> None:
    async with slow_drives() as (control, url):
        control.answer.set()
        nc = Sinumerik(SinumerikSettings(security="none", url=url, timeout_s=TIMEOUT_S), SystemClock())
        bus, (first, second) = channels_of(url, tmp_path)
        try:
            await nc.connect()
            await nc.claim(OWNER, WatchdogTerms(silence_s=60.0, ramp_um_per_s=2.0))
            await nc.write_compensation((3.0, 2.0, 1.0))
            await bus.connect()
            for device in (first, second):
                await device.connect()
                speed, motor = await device.read()
                assert (speed.quality, motor.quality) == (Quality.GOOD, Quality.COMM_FAULT)
            assert control.sessions == 2, "one that writes, and one of the bus, however many devices it has"

            control.answer.clear()
            reading = asyncio.create_task(first.read())
            await control.asked.wait()
            for _ in range(20):
                assert await nc.heartbeat(OWNER)
                await nc.snapshot()
                await nc.write_compensation((3.0, 2.0, 1.0))
            assert not reading.done(), "twenty periods of the NC, and the reading hangs all the time"
            with pytest.raises(NoAnswer, match=r"bus control, device first: no answer within 0\.5 s"):
                await reading

            control.answer.set()
            assert await nc.heartbeat(OWNER), "the session that writes the offsets is the same"
            assert await nc.read_compensation() == pytest.approx((3.0, 2.0, 1.0))
            await bus.connect()
            assert (await second.read())[0].quality is Quality.GOOD
        finally:
            await bus.close()
            await nc.close()


async def test_in_one_session_such_a_reading_would_end_it() -> None:
    """This is why they do not share one: requests after the hanging one wait for its answer, and time out, too."""
    async with slow_drives() as (control, url):
        settings = SinumerikSettings(security="none", url=url, timeout_s=TIMEOUT_S)
        session = OpcUaSession(settings, "", {}, "SinumerikVarProvider")
        await session.connect()
        reading = asyncio.create_task(session.read((DRIVE,)))
        await control.asked.wait()
        with pytest.raises(NoAnswer):
            await session.read((SPINDLE,))
        assert not session.is_open
        await asyncio.gather(reading, return_exceptions=True)
        await session.close()
