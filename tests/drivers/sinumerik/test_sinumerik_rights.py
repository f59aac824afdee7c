"""What a SINUMERIK must have and permit: named when connecting, and when writing is tried, not when it is needed."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest

from drivers.base import Refused, WrongDevice
from drivers.sinumerik.control import Sinumerik
from drivers.sinumerik.make import make_sinumerik
from drivers.sinumerik.settings import Handshake, LeaseParameters, OffsetRoute, SinumerikSettings
from simulators.nc import Activity, DayPart, EmulatedControl, LoadCase, MeanLoads
from tests.benches.emulated_bench import Rigid
from tests.benches.error_program import R_COUNT, program
from tests.benches.error_program import settings as with_errors
from tests.benches.manual_clock import ManualClock

pytestmark = pytest.mark.simulated_time

ABSENT = 200
TRAVEL = ((-300.0, 300.0), (-200.0, 200.0), (0.0, 400.0))
TABLES = {"XY": 0, "XZ": 1, "YX": 2, "YZ": 3, "ZX": 4, "ZY": 5}
PLAIN = OffsetRoute()
SLOPES = OffsetRoute(route="k0_slope", travel_mm=TRAVEL, tables=TABLES)
LEASE = [*LeaseParameters.model_fields]
ASKING = ("request", "withdraw", "valid_for")


@asynccontextmanager
async def control(*programs: str) -> AsyncIterator[tuple[EmulatedControl, str]]:
    day = LoadCase([DayPart(0.0, 1e9, Activity.ROUGHING, MeanLoads())])
    emulated = EmulatedControl(Rigid(), ManualClock(), day, programs=programs, r_count=R_COUNT)
    try:
        yield emulated, await emulated.start()
    finally:
        await emulated.stop()


async def connected(settings: SinumerikSettings) -> Sinumerik:
    nc = make_sinumerik(settings, ManualClock())
    assert isinstance(nc, Sinumerik)
    await nc.connect()
    return nc


def r(number: int) -> str:
    return f"/Channel/Parameter/R[u1,{number}]"


def axes(name: str) -> list[str]:
    return [f"/NC/_N_AX_SEA_ACX/$SA_TEMP_COMP_{name}[u{axis}]" for axis in (1, 2, 3)]


HANDED = [r(60), r(61), r(62)]
OWNED = [r(93), r(94), r(95), r(97)]
WEIGHTS = [f"/NC/_N_NC_SEA_ACX/$SN_CEC_TABLE_WEIGHT[{table + 1}]" for table in TABLES.values()]
WRITTEN = {
    "k0": [*HANDED, *OWNED, *axes("ABS_VALUE")],
    "k0_slope": [*HANDED, *OWNED, r(98), *axes("ABS_VALUE"), *axes("SLOPE"), *axes("REF_POSITION"), *WEIGHTS],
    "r": [*HANDED, *OWNED, r(90), r(91), r(92)],
    "errors": [*HANDED, *OWNED, *(r(100 + i) for i in range(9))],
    "errors without its program": [*HANDED, *OWNED, *axes("ABS_VALUE")],
}


@pytest.mark.parametrize("name", LEASE)
async def test_a_parameter_of_the_lease_that_the_control_lacks_is_named_when_connecting(name: str) -> None:
    lacking = LeaseParameters(**{name: ABSENT})
    async with control() as (_, url):
        settings = SinumerikSettings(security="none", url=url, lease=lacking, compensation=SLOPES)
        with pytest.raises(WrongDevice, match=rf"R\[u1,{ABSENT}\] does not exist"):
            await connected(settings)
        nc = await connected(settings.model_copy(update={"writes": False}))
        await nc.snapshot()
        await nc.close()


async def test_the_ramp_of_slopes_is_needed_with_slopes_alone() -> None:
    async with control() as (_, url):
        lease = LeaseParameters(slope_ramp=ABSENT)
        nc = await connected(SinumerikSettings(security="none", url=url, lease=lease, compensation=PLAIN))
        await nc.close()


@pytest.mark.parametrize("name", ASKING)
async def test_a_parameter_of_a_request_that_the_control_lacks_is_named_when_connecting(name: str) -> None:
    lacking = Handshake(**{name: ABSENT})
    async with control() as (_, url):
        settings = SinumerikSettings(security="none", url=url, handshake=lacking)
        with pytest.raises(WrongDevice, match=rf"R\[u1,{ABSENT}\] does not exist"):
            await connected(settings)


@pytest.mark.parametrize("name", ["withdraw", "valid_for"])
async def test_a_gateway_that_requests_no_cycle_needs_no_parameter_to_withdraw_one(name: str) -> None:
    async with control() as (_, url):
        lacking = Handshake(**{name: ABSENT})
        nc = await connected(SinumerikSettings(security="none", url=url, handshake=lacking, asks=False))
        await nc.snapshot()
        await nc.close()


async def test_a_parameter_of_the_nine_errors_is_named_when_connecting() -> None:
    async with control(program()) as (_, url):
        for name in ("wanted", "in_force", "echo", "probed", "terms"):
            known = with_errors(url)
            lacking = known.model_copy(update={"errors": type(known.errors)(**{name: ABSENT})})
            with pytest.raises(WrongDevice, match=rf"R\[u1,{ABSENT}\] does not exist"):
                await connected(lacking)


@pytest.mark.parametrize("route", WRITTEN)
async def test_trying_to_write_names_each_node_that_is_written_when_the_control_refuses_it(route: str) -> None:
    async with control(*([program()] if route == "errors" else ())) as (emulated, url):
        compensation = SLOPES if route == "k0_slope" else OffsetRoute(route="r") if route == "r" else PLAIN
        settings = SinumerikSettings(security="none", url=url, compensation=compensation)
        nc = await connected(with_errors(url) if route.startswith("errors") else settings)
        for path in WRITTEN[route]:
            emulated.write_protected = {path}
            with pytest.raises(Refused) as refused:
                await nc.try_writing()
            assert refused.value.what.startswith(f"the server does not let the gateway write {path} (")
        emulated.write_protected = set()
        await nc.try_writing()
        await nc.close()
