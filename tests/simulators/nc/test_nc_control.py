"""The emulated control on the wire, queried by a plain OPC UA client instead of our driver."""

import asyncio
from collections.abc import AsyncIterator
from datetime import UTC, datetime

import pytest
from asyncua import ua
from asyncua.client.client import Client
from asyncua.ua.status_codes import StatusCodes

from simulators.nc import Activity, CycleSettings, DayPart, EmulatedControl, LoadCase, MeanLoads
from simulators.nc.control import NAMESPACE_URI
from simulators.nc.nck import R_REQUEST
from tests.benches.manual_clock import ManualClock

pytestmark = pytest.mark.simulated_time


class Touched:
    """Remembers when the probe came."""

    def __init__(self) -> None:
        self.at_s: list[float] = []

    def tool_deviation_um(
        self, time_s: float, x_mm: float, y_mm: float, z_mm: float, a_deg: float, c_deg: float
    ) -> tuple[float, float, float]:
        self.at_s.append(time_s)
        return 1.0, 2.0, 3.0


@pytest.fixture
async def clock() -> ManualClock:
    return ManualClock()


@pytest.fixture
def machine() -> Touched:
    return Touched()


@pytest.fixture
async def control(clock: ManualClock, machine: Touched) -> AsyncIterator[EmulatedControl]:
    day = LoadCase([DayPart(0.0, 1e6, Activity.ROUGHING, MeanLoads(x=600.0))], operation_s=40.0)
    control = EmulatedControl(machine, clock, day, cycle=CycleSettings(noise_um=0.0))
    yield control
    await control.stop()
    await asyncio.get_running_loop().shutdown_default_executor()


async def test_the_cycle_goes_on_while_nobody_reads(
    control: EmulatedControl, clock: ManualClock, machine: Touched
) -> None:
    url = await control.start()
    async with Client(url) as client:
        index = await client.get_namespace_index(NAMESPACE_URI)
        request = client.get_node(f"ns={index};s=/Channel/Parameter/R[u1,{R_REQUEST}]")
        await clock.pass_to(5.0)
        await request.write_value(7.0)
    seen = []
    for now in range(6, 200):
        await clock.pass_to(float(now))
        seen.append(len(machine.at_s))
    assert seen[-1] == 6
    assert seen.index(1) + 6 - machine.at_s[0] < 1.0, "a touch is processed when it is due, not when somebody reads"


async def test_names_values_and_types_as_a_client_sees_them(control: EmulatedControl, clock: ManualClock) -> None:
    url = await control.start()
    async with Client(url) as client:
        index = await client.get_namespace_index(NAMESPACE_URI)

        async def value(path: str) -> ua.DataValue:
            return await client.get_node(f"ns={index};s={path}").read_data_value(raise_on_bad_status=False)

        await clock.pass_to(6.0)
        position = await value("/Channel/MachineAxis/actToolBasePos[u1,1]")
        assert position.Value is not None
        assert (position.Value.VariantType, position.Value.Value) == (ua.VariantType.Double, pytest.approx(60.0))
        assert position.SourceTimestamp == datetime(2026, 1, 1, 0, 0, 6, tzinfo=UTC)
        mode = await value("/Bag/State/opMode[u1]")
        assert mode.Value is not None
        assert (mode.Value.VariantType, mode.Value.Value) == (ua.VariantType.UInt32, 2)
        unlisted = await value("/Channel/Parameter/R[u1,10]")
        assert unlisted.Value is not None
        assert unlisted.Value.Value == 0.0
        unknown = await value("/Channel/Parameter/R[u1,100]")
        assert unknown.StatusCode is not None
        assert unknown.StatusCode.value == StatusCodes.BadNodeIdUnknown


async def test_what_cannot_be_written(control: EmulatedControl) -> None:
    url = await control.start()
    async with Client(url) as client:
        index = await client.get_namespace_index(NAMESPACE_URI)
        position = client.get_node(f"ns={index};s=/Channel/MachineAxis/actToolBasePos[u1,1]")
        parameter = client.get_node(f"ns={index};s=/Channel/Parameter/R[u1,10]")
        with pytest.raises(ua.uaerrors.BadNotWritable):
            await position.write_value(1.0)
        with pytest.raises(ua.uaerrors.BadTypeMismatch):
            await parameter.write_value("one")
        assert await parameter.read_value() == 0.0
