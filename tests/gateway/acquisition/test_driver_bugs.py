"""Whatever a driver or its library raises or returns is a fault of its device; the neighbours are not affected."""

import asyncio
import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import pytest

from drivers.base import Quality, Reading
from tests.benches.scripted_bus import ScriptedPlant

BUGS = [ValueError("bad value"), IndexError("list index"), struct.error("unpack"), AssertionError()]
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
