"""Whatever a driver or its library raises or returns is a fault of its device; the neighbours are not affected."""

import asyncio
import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import pytest

from drivers.base import NoAnswer, Quality, Reading
from tests.benches.scripted_bus import ScriptedBus, ScriptedDevice, ScriptedPlant

BUGS = [ValueError("bad value"), IndexError("list index"), struct.error("unpack"), AssertionError(), SystemExit(1)]
CANCELLED = asyncio.CancelledError()


@pytest.mark.parametrize("error", [*BUGS, CANCELLED], ids=lambda error: type(error).__name__)
@pytest.mark.parametrize("operation", ["connect", "read"])
async def test_what_a_driver_raises_is_its_device_s_fault_and_ends_with_it(
    operation: str, error: BaseException
) -> None:
    plant = ScriptedPlant("a", "b")

    async def raises() -> None:
        raise error

    setattr(plant.devices["a"], operation, raises)
    async with plant.running():
        await plant.clock.run_until(20.0)
        assert plant.of("a")[-1].quality is Quality.COMM_FAULT
        assert {r.quality for r in plant.of("b")} == {Quality.GOOD}
        assert len(plant.of("b")) == 21
        delattr(plant.devices["a"], operation)
        await plant.clock.run_until(60.0)
        assert plant.of("a")[-1].quality is Quality.GOOD
    assert plant.told() == [("device a", False), ("device a", True)]


@pytest.mark.parametrize("error", [*BUGS, CANCELLED], ids=lambda error: type(error).__name__)
async def test_what_a_bus_raises_when_it_opens_or_closes_ends_nothing(error: BaseException) -> None:
    plant = ScriptedPlant("a")

    async def raises() -> None:
        raise error

    setattr(plant.bus, "close", raises)  # noqa: B010 - a method
    setattr(plant.bus, "connect", raises)  # noqa: B010
    async with plant.running():
        await plant.clock.run_until(20.0)
        assert plant.of("a")[-1].quality is Quality.COMM_FAULT
        delattr(plant.bus, "connect")
        await plant.clock.run_until(60.0)
        assert plant.of("a")[-1].quality is Quality.GOOD


class OddBus(ScriptedBus):
    """A bus with a bug in its parts beside the requests: the time limit, and hearing another master."""

    def __init__(self, broken: str) -> None:
        super().__init__()
        self.broken = broken

    def limit(self, left_s: float) -> None:
        if self.broken == "limit" and left_s < math.inf:
            raise ValueError("no such limit")

    def other_master(self) -> str:
        if self.broken == "other_master":
            raise ValueError("no such byte")
        return ""


def odd_plant(broken: str, *names: str) -> ScriptedPlant:
    plant = ScriptedPlant(*names)
    plant.bus = OddBus(broken)
    plant.devices = {name: ScriptedDevice(name, plant.clock, plant.bus) for name in names}
    return plant


async def test_a_bus_that_cannot_be_told_its_limit_costs_the_device_that_is_asked_again() -> None:
    plant = odd_plant("limit", "a", "b")
    async with plant.running():
        await plant.clock.run_until(5.0)
        plant.devices["a"].fault_once = NoAnswer("late")
        await plant.clock.run_until(20.0)
    assert [r.quality for r in plant.of("a")].count(Quality.COMM_FAULT) == 1
    assert plant.of("a")[-1].quality is Quality.GOOD
    assert {r.quality for r in plant.of("b")} == {Quality.GOOD}
    assert "unexpected ValueError: no such limit" in plant.notices[0].text


async def test_a_bus_that_fails_to_say_who_else_is_on_its_line_is_read_all_the_same() -> None:
    plant = odd_plant("other_master", "a")
    async with plant.running():
        await plant.clock.run_until(20.0)
    assert len(plant.of("a")) == 21
    assert {r.quality for r in plant.of("a")} == {Quality.GOOD}
    assert plant.told() == [("line of bus rtu1", False)]


class AskingDevice(ScriptedDevice):
    """A device with a bug where it says whether it is to be asked for something later."""

    @property
    def asks_later(self) -> bool:
        if self.asked:
            raise ValueError("no such address")
        return False

    async def ask_later(self) -> None:
        pass


class LaterDevice(ScriptedDevice):
    """A device that always wants to be asked for something later."""

    asks_later = True
    later = 0

    async def ask_later(self) -> None:
        self.later += 1
        self.clock.spend(0.3)


async def test_only_one_device_a_period_is_asked_for_what_it_left_out() -> None:
    plant = ScriptedPlant("a", "b", "c", "d")
    devices = [LaterDevice(name, plant.clock, plant.bus) for name in plant.devices]
    plant.devices = {device.device: device for device in devices}
    async with plant.running() as acquisition:
        await plant.clock.run_until(9.9)
        assert acquisition.runners["rtu1"].missed == 0
    assert sum(device.later for device in devices) == 10


async def test_a_device_that_fails_to_say_whether_it_is_asked_later_ends_no_other(
    caplog: pytest.LogCaptureFixture,
) -> None:
    plant = ScriptedPlant("a", "b")
    plant.devices["a"] = AskingDevice("a", plant.clock, plant.bus)
    async with plant.running():
        await plant.clock.run_until(20.0)
    assert len(plant.of("b")) == 21
    assert {r.quality for r in plant.of("b")} == {Quality.GOOD}
    assert {notice.subject for notice in plant.notices} == {"device a"}
    assert len([record for record in caplog.records if record.exc_info]) == 1


@pytest.mark.slow
async def test_a_bug_that_comes_and_goes_has_its_traceback_in_the_log_once(caplog: pytest.LogCaptureFixture) -> None:
    plant = ScriptedPlant("a")
    async with plant.running():
        for hour in range(4):
            plant.devices["a"].fault_once = ValueError(f"bad value {hour}")
            await plant.clock.run_until(3600.0 * hour + 60.0)
    told = [record for record in caplog.records if "unexpected ValueError" in record.getMessage()]
    assert [record.getMessage()[-1] for record in told] == ["0", "1", "2", "3"]
    assert [bool(record.exc_info) for record in told] == [True, False, False, False]


WRONG: dict[str, Callable[[Any], object]] = {
    "none": lambda _: None,
    "none of them": lambda _: [],
    "twice": lambda readings: [*readings, *readings],
    "another channel": lambda readings: [replace(readings[0], channel="other")],
    "numbers": lambda _: [20.0],
    "good without a number": lambda readings: [replace(readings[0], value=math.nan)],
    "good and infinite": lambda readings: [replace(readings[0], value=math.inf)],
    "a text": lambda readings: [replace(readings[0], value="20")],
    "no value": lambda readings: [replace(readings[0], value=None)],
    "a quality of its own": lambda readings: [replace(readings[0], quality="fine")],
}


@pytest.mark.parametrize("name", WRONG)
async def test_readings_that_the_interface_excludes_are_the_device_s_fault(name: str) -> None:
    plant = ScriptedPlant("a", "b")
    genuine = plant.devices["a"].read

    async def answers(*, again: bool = False) -> Sequence[Reading]:
        return WRONG[name](await genuine())  # type: ignore[return-value]

    setattr(plant.devices["a"], "read", answers)  # noqa: B010
    async with plant.running():
        await plant.clock.run_until(5.0)
        assert {r.quality for r in plant.of("a")} == {Quality.COMM_FAULT}
        assert all(isinstance(r.value, float) for r in plant.of("a"))
        assert {r.quality for r in plant.of("b")} == {Quality.GOOD}
        delattr(plant.devices["a"], "read")
        await plant.clock.run_until(30.0)
        assert plant.of("a")[-1].quality is Quality.GOOD


@pytest.mark.parametrize("operation", ["connect", "read"])
async def test_a_computer_without_memory_is_no_fault_of_a_device(operation: str) -> None:
    plant = ScriptedPlant("a")

    async def raises(*, again: bool = False) -> None:
        raise MemoryError

    setattr(plant.devices["a"], operation, raises)
    with pytest.raises(ExceptionGroup) as caught:
        async with plant.running():
            await plant.clock.run_until(3.0)
    assert caught.group_contains(MemoryError)
