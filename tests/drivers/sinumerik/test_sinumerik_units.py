"""A SINUMERIK with an inch system is refused by name, also when an operator switches it while the gateway runs."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from drivers.base import ConnectError, Refused, WrongDevice
from drivers.sinumerik.control import Sinumerik
from drivers.sinumerik.settings import Paths, SinumerikSettings
from simulators.nc import Activity, DayPart, EmulatedControl, LoadCase, MeanLoads, User
from simulators.nc.variables import AccessRight
from tests.benches.emulated_bench import Rigid
from tests.benches.manual_clock import ManualClock

pytestmark = pytest.mark.simulated_time

INCH = r"the control's basic system is inch \(/NC/_N_NC_TEA_ACX/\$MN_SCALING_SYSTEM_IS_METRIC = 0\)"
ONLY_READS = {"asks": False, "writes": False}


@asynccontextmanager
async def control(users: dict[str, User] | None = None) -> AsyncIterator[tuple[EmulatedControl, SinumerikSettings]]:
    day = LoadCase([DayPart(0.0, 1e9, Activity.ROUGHING, MeanLoads())])
    emulated = EmulatedControl(Rigid(), ManualClock(), day, users=users)
    try:
        yield emulated, SinumerikSettings(security="none", url=await emulated.start())
    finally:
        await emulated.stop()


@pytest.mark.parametrize("way", [{}, {"subscribe_s": 0.05}, ONLY_READS])
async def test_an_inch_system_is_refused_when_connecting(way: dict[str, object]) -> None:
    async with control() as (emulated, settings):
        emulated.nck.metric = False
        nc = Sinumerik(settings.model_copy(update=way), ManualClock())
        with pytest.raises(WrongDevice, match=INCH):
            await nc.connect()
        with pytest.raises(ConnectError, match="connect first"):
            await nc.write_compensation((1.0, 2.0, 3.0))
        assert emulated.nck.k0_mm == [0.0, 0.0, 0.0]


async def test_a_control_that_is_switched_to_inch_gives_no_position_before_the_next_write() -> None:
    async with control() as (emulated, settings):
        nc = Sinumerik(settings, ManualClock())
        await nc.connect()
        await nc.snapshot()
        emulated.nck.metric = False
        with pytest.raises(WrongDevice, match=INCH):
            await nc.snapshot()
        emulated.nck.metric = True
        await nc.snapshot()
        await nc.close()


async def test_a_gateway_that_only_reads_works_without_the_right_to_read_the_unit_and_one_that_writes_does_not(
    tmp_path: Path,
) -> None:
    password = tmp_path / "password"
    password.write_text("secret")
    users = {"watcher": User("secret", frozenset(AccessRight) - {AccessRight.TEA_READ})}
    async with control(users) as (emulated, settings):
        emulated.nck.metric = False
        named = settings.model_copy(update={"user": "watcher", "password_file": password})
        nc = Sinumerik(named.model_copy(update=ONLY_READS), ManualClock())
        await nc.connect()
        await nc.close()
        with pytest.raises(Refused, match=r"SCALING_SYSTEM_IS_METRIC.*the right TeaRead"):
            await Sinumerik(named, ManualClock()).connect()


async def test_without_a_node_name_the_unit_is_not_read() -> None:
    async with control() as (emulated, settings):
        emulated.nck.metric = False
        nc = Sinumerik(settings.model_copy(update={"nodes": Paths(metric="")}), ManualClock())
        await nc.connect()
        await nc.snapshot()
        await nc.close()
