"""Snapshots without polling: the control reports changes, and is polled when it does not."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from datetime import datetime

import pytest
from asyncua.ua.status_codes import StatusCodes

from drivers.base import DriverError, SystemClock
from drivers.nc import NcSnapshot, OperatingMode
from drivers.sinumerik.control import Sinumerik
from drivers.sinumerik.settings import SinumerikSettings
from gateway.runtime.clocks import RealClock
from simulators.nc import Activity, DayPart, EmulatedControl, LoadCase, MeanLoads
from simulators.nc.nck import AUTO, JOG
from tests.benches.emulated_bench import Rigid

pytestmark = pytest.mark.simulated_time


class CountedControl(EmulatedControl):
    """Counts how often a client asks."""

    requests = 0

    def utc(self) -> datetime:
        self.requests += 1  # every read request stamps its values with the time, once
        return super().utc()


@asynccontextmanager
async def watched(subscriptions: bool = True) -> AsyncIterator[tuple[Sinumerik, CountedControl]]:
    still = LoadCase([DayPart(0.0, 1e9, Activity.PAUSE, MeanLoads())])
    control = CountedControl(Rigid(), RealClock(), still, subscriptions=subscriptions)
    url = await control.start()
    nc = Sinumerik(SinumerikSettings(security="none", url=url, subscribe_s=0.05, timeout_s=1.0), SystemClock())
    try:
        await nc.connect()
        yield nc, control
    finally:
        await nc.close()
        await control.stop()
        await asyncio.get_running_loop().shutdown_default_executor()


async def until(
    snapshot: Callable[[], Awaitable[NcSnapshot]], shows: Callable[[NcSnapshot], bool], limit_s: float = 3.0
) -> NcSnapshot:
    """The first snapshot that shows something; fails after `limit_s`."""
    async with asyncio.timeout(limit_s):
        while not shows(seen := await snapshot()):
            await asyncio.sleep(0.01)
    return seen


async def test_changes_arrive_without_asking() -> None:
    async with watched() as (nc, control):
        assert (await until(nc.snapshot, lambda s: s.mode is OperatingMode.AUTO)).alarms == ()
        await asyncio.sleep(0.2)  # the first values of all nodes have come
        before = control.requests
        control.nck.set_mode(JOG, 0.0)
        control.nck.raise_alarm(21612, 0.0)
        seen = await until(nc.snapshot, lambda s: s.mode is OperatingMode.JOG and s.alarms != ())
        assert seen.alarms == (21612,)
        assert seen.positions["Z"] == 150.0
        assert control.requests == before


async def test_a_control_that_refuses_subscriptions_is_asked() -> None:
    async with watched(subscriptions=False) as (nc, control):
        control.nck.set_mode(JOG, 0.0)
        assert (await nc.snapshot()).mode is OperatingMode.JOG


@pytest.mark.slow
async def test_the_subscription_is_back_after_the_control_was_away() -> None:
    async with watched() as (nc, control):
        await control.stop()
        with pytest.raises(DriverError):
            await nc.snapshot()
        control.nck.set_mode(JOG, 0.0)
        await control.start()
        await nc.connect()
        assert (await nc.snapshot()).mode is OperatingMode.JOG
        await asyncio.sleep(0.2)
        before = control.requests
        control.nck.set_mode(AUTO, 0.0)
        await until(nc.snapshot, lambda s: s.mode is OperatingMode.AUTO)
        assert control.requests == before


async def told(nc: Sinumerik, control: CountedControl) -> None:
    """Return when the first values of all nodes have come and nothing is polled any more."""
    async with asyncio.timeout(3.0):
        while True:
            before = control.requests
            await nc.snapshot()
            if control.requests == before:
                return
            await asyncio.sleep(0.05)


async def test_a_subscription_that_falls_silent_is_no_longer_trusted() -> None:
    async with watched() as (nc, control):
        await told(nc, control)
        await control.subscriptions.fall_silent()  # also those that the library makes again; reads are answered
        control.nck.set_mode(JOG, 0.0)
        assert (await nc.snapshot()).mode is OperatingMode.AUTO, "as told last"
        await until(nc.snapshot, lambda s: s.mode is OperatingMode.JOG, limit_s=5.0)


async def test_a_subscription_whose_status_changes_is_no_longer_trusted_though_it_sends_keepalives() -> None:
    async with watched() as (nc, control):
        await told(nc, control)
        control.sampling = False  # no changes are reported any more
        control.nck.set_mode(JOG, 0.0)
        await asyncio.sleep(1.5)  # longer than a sign of life takes to come
        assert (await nc.snapshot()).mode is OperatingMode.AUTO
        await control.subscriptions.change_status(StatusCodes.BadTimeout)
        await until(nc.snapshot, lambda s: s.mode is OperatingMode.JOG)
