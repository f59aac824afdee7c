"""What every device driver does, shown over the real wire: loopback TCP and pseudo-terminals."""

import asyncio
import contextlib
import time
from dataclasses import replace
from datetime import timedelta
from math import isnan
from pathlib import Path

import pytest

from drivers.base import ConnectError, DriverError, NoAnswer, Quality, WrongDevice
from tests.benches.buses import make_bus
from tests.benches.rigs import NEIGHBOUR, SHARED, TIMEOUT_S, TYPED, Rig

pytestmark = pytest.mark.simulated_time


async def test_values_arrive_within_quantisation(rig: Rig) -> None:
    async with rig.connected() as (_, driver):
        readings = await driver.read()
    assert [r.channel for r in readings] == list(driver.channels)
    assert {r.unit for r in readings} == {rig.unit}
    assert {r.quality for r in readings} == {Quality.GOOD}
    assert [r.value for r in readings] == pytest.approx(rig.true_values, abs=rig.tolerance * 1.0001)


async def test_readings_carry_their_times(rig: Rig) -> None:
    async with rig.connected() as (_, driver):
        first = await driver.read()
        await asyncio.sleep(rig.settle_s)
        second = await driver.read()
    if not rig.by_frames:
        assert {r.monotonic_s for r in second} == {second[0].monotonic_s}, "one read, one time"
    assert second[0].monotonic_s > first[0].monotonic_s
    assert second[0].source_time.utcoffset() == timedelta(0)


async def test_each_sensor_fault_is_reported_on_its_channel_alone(rig: Rig) -> None:
    async with rig.connected() as (_, driver):
        for fault, quality in rig.fault_qualities.items():
            await rig.break_sensor(0, fault)
            broken, *others = await driver.read()
            assert (fault, broken.quality) == (fault, quality)
            assert isnan(broken.value)
            assert broken.detail
            assert {r.quality for r in others} <= {Quality.GOOD}
        await rig.break_sensor(0, None)
        assert (await driver.read())[0].quality is Quality.GOOD


async def test_silent_device_is_reported_in_time_and_recovers(rig: Rig) -> None:
    async with rig.connected() as (_, driver):
        await rig.silence()
        started = time.monotonic()
        with pytest.raises(NoAnswer) as caught:
            await driver.read()
        assert time.monotonic() - started < 3 * TIMEOUT_S
        assert (caught.value.bus, caught.value.device) == ("bus1", "device1")
        assert caught.value.hint
        await rig.silence(False)
        assert [r.value for r in await driver.read()] == pytest.approx(rig.true_values, abs=rig.tolerance * 1.0001)


@pytest.mark.parametrize("rig", SHARED, indirect=True)
async def test_silent_device_leaves_its_neighbour_alone(rig: Rig) -> None:
    async with rig.connected() as (bus, driver):
        neighbour = rig.make_neighbour(bus)
        await rig.silence()
        for _ in range(3):
            with pytest.raises(NoAnswer):
                await driver.read()
            assert [r.value for r in await neighbour.read()][-1] == pytest.approx(NEIGHBOUR, abs=rig.tolerance)


@pytest.mark.parametrize("rig", SHARED, indirect=True)
async def test_concurrent_reads_on_one_bus_do_not_mix(rig: Rig) -> None:
    async with rig.connected() as (bus, driver):
        neighbour = rig.make_neighbour(bus)
        for _ in range(5):
            mine, theirs = await asyncio.gather(driver.read(), neighbour.read())
            assert mine[-1].value == pytest.approx(rig.true_values[-1], abs=rig.tolerance * 1.0001)
            assert theirs[-1].value == pytest.approx(NEIGHBOUR, abs=rig.tolerance)


@pytest.mark.parametrize("rig", TYPED, indirect=True)
async def test_wrong_sensor_is_refused_at_connect(rig: Rig) -> None:
    rig.spoil_identity()
    with pytest.raises(WrongDevice) as caught:
        async with rig.connected():
            pass
    assert caught.value.channel
    assert caught.value.hint


@pytest.mark.parametrize("rig", TYPED, indirect=True)
async def test_device_that_returns_with_another_sensor_is_refused(rig: Rig) -> None:
    async with rig.connected() as (_, driver):
        await driver.read()
        await rig.silence()
        with pytest.raises(NoAnswer):
            await driver.read()
        rig.spoil_identity()
        await rig.silence(False)
        for _ in range(2):
            with pytest.raises(WrongDevice):
                await driver.read()


async def test_cancelled_read_does_not_spoil_the_next(rig: Rig) -> None:
    async with rig.connected() as (_, driver):
        for _ in range(5):
            task = asyncio.ensure_future(driver.read())
            for _ in range(3):
                await asyncio.sleep(0)
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await task
            values = [r.value for r in await driver.read()]
            assert values == pytest.approx(rig.true_values, abs=rig.tolerance * 1.0001)


async def test_reconnects_after_close(rig: Rig) -> None:
    bus = make_bus("bus1", rig.kind, rig.options)
    driver = rig.make(bus)
    for _ in range(2):
        await bus.connect()
        await driver.connect()
        assert len(await driver.read()) == len(rig.true_values)
        await driver.close()
        await bus.close()
    await bus.close()


async def test_read_without_connection_says_so(rig: Rig) -> None:
    with pytest.raises(ConnectError, match="not connected"):
        await rig.make(make_bus("bus1", rig.kind, rig.options)).read()


async def test_wire_that_goes_away_is_reported(rig: Rig, tmp_path: Path) -> None:
    """By a name that disappears with it, as udev's does: its terminal's number may be another test's by then."""
    link, options = tmp_path / "adapter", dict(rig.options)
    for key, place in rig.options.items():
        if str(place).startswith("/dev/pts/"):
            link.symlink_to(str(place))
            options[key] = str(link)
    async with replace(rig, options=options).connected() as (bus, driver):
        await rig.cut_wire()
        link.unlink(missing_ok=True)
        for _ in range(3):
            with pytest.raises((ConnectError, NoAnswer)) as caught:
                await driver.read()
        assert isinstance(caught.value, ConnectError)
        await bus.close()
        with pytest.raises(DriverError):
            await bus.connect()
