"""Reading a bus once: every device has its turn, whatever happened to the one before, and nothing stays open."""

import pytest

from drivers.base import ConnectError, NoAnswer, Quality, WrongDevice
from gateway.acquisition.once import DeviceAnswer, read_once
from gateway.config.sections import Limits
from tests.benches.scripted_bus import ScriptedPlant


async def once(plant: ScriptedPlant, *, keep_open: bool = False) -> dict[str, DeviceAnswer]:
    with plant.clock.hold():  # as a command does on the real clock: no simulated time passes
        return {answer.device: answer for answer in await read_once(plant.line(), plant.clock, keep_open=keep_open)}


def qualities(answers: dict[str, DeviceAnswer]) -> dict[str, Quality]:
    return {device: answer.readings[0].quality for device, answer in answers.items()}


async def test_a_silent_device_is_asked_once_and_its_neighbours_too() -> None:
    plant = ScriptedPlant("a", "b", "c")
    plant.devices["b"].fault = NoAnswer("silent", device="b")
    plant.devices["b"].fault_takes_s, plant.devices["c"].takes_s = 0.5, 0.1
    answers = await once(plant)
    assert qualities(answers) == {"a": Quality.GOOD, "b": Quality.COMM_FAULT, "c": Quality.GOOD}
    assert answers["b"].readings[0].detail == str(answers["b"].error) == "device b: silent"
    assert (answers["a"].took_s, answers["b"].took_s) == (0.0, None)
    assert answers["c"].took_s == pytest.approx(0.1)
    assert [len(device.asked) for device in plant.devices.values()] == [1, 1, 1]
    assert not plant.bus.is_open


async def test_a_device_that_breaks_the_connection_hides_no_other() -> None:
    plant = ScriptedPlant("a", "b")
    plant.devices["a"].fault = ConnectError("connection reset", device="a")
    answers = await once(plant)
    assert qualities(answers) == {"a": Quality.COMM_FAULT, "b": Quality.GOOD}
    assert plant.bus.opened == 2


async def test_a_bus_that_cannot_be_opened_is_tried_once_and_says_why_on_every_channel() -> None:
    plant = ScriptedPlant("a", "b")
    plant.bus.fault = ConnectError("no such port", bus="rtu1")
    answers = await once(plant)
    assert {r.detail for answer in answers.values() for r in answer.readings} == {"bus rtu1: no such port"}
    assert set(qualities(answers).values()) == {Quality.COMM_FAULT}
    assert [answer.error for answer in answers.values()] == [None, None]
    assert plant.bus.closed == 2, "once as it failed, once at the end"


async def test_limits_are_those_of_a_run_and_a_bug_in_a_driver_is_an_answer() -> None:
    plant = ScriptedPlant("a", "b", "c")
    plant.plausible = {"a_t": Limits(max=10.0)}
    plant.devices["b"].fault = ValueError("a bug")
    plant.devices["c"].fault_at_connect = WrongDevice("type code 0x20, expected 0x2A", device="c")
    answers = await once(plant)
    assert qualities(answers) == {"a": Quality.OUT_OF_RANGE, "b": Quality.COMM_FAULT, "c": Quality.COMM_FAULT}
    assert answers["a"].readings[0].value == pytest.approx(20.0, abs=0.1)
    assert answers["b"].readings[0].detail == "device b: unexpected ValueError: a bug"
    assert isinstance(answers["c"].error, WrongDevice)


async def test_a_bus_that_was_open_can_stay_open() -> None:
    plant = ScriptedPlant("a")
    await plant.bus.connect()
    assert qualities(await once(plant, keep_open=True)) == {"a": Quality.GOOD}
    assert plant.bus.is_open
