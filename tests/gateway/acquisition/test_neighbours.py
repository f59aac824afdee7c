"""How devices that are silent, intermittent or slow affect the others on their bus. The drivers here are scripts."""

import numpy as np
import pytest

from drivers.base import BadAnswer, NoAnswer, Quality
from tests.benches.scripted_bus import ScriptedPlant

FIVE = ("a", "b", "c", "d", "e")
TAKES_S, SHORT_S, FULL_S = 0.02, 0.05, 0.5
"""How long an answer takes; how long a bus waits for a device that is usually quick, and for one that was silent
before."""


def five() -> ScriptedPlant:
    plant = ScriptedPlant(*FIVE)
    for device in plant.devices.values():
        device.takes_s, device.first_fault_takes_s, device.fault_takes_s = TAKES_S, SHORT_S, FULL_S
    return plant


def intervals(plant: ScriptedPlant, device: str) -> np.ndarray:
    return np.diff([r.monotonic_s for r in plant.of(device)])


async def test_an_answer_that_is_late_for_once_is_no_fault_and_delays_nobody_further() -> None:
    plant = five()
    async with plant.running():
        await plant.clock.run_until(9.5)
        plant.devices["b"].fault_once = NoAnswer("an answer was lost")
        await plant.clock.run_until(20.5)
    assert {r.quality for r in plant.readings} == {Quality.GOOD}
    assert plant.notices == []
    assert [t for t in plant.devices["b"].asked if 9.5 < t < 10.9] == pytest.approx([10.02, 10.13])
    assert plant.devices["c"].asked[10] == pytest.approx(10.02 + SHORT_S)


async def test_an_answer_that_a_late_one_of_another_unit_disturbed_is_no_fault() -> None:
    plant = five()
    async with plant.running():
        await plant.clock.run_until(9.5)
        plant.devices["b"].fault_once = NoAnswer("an answer was lost")
        plant.devices["c"].fault_once = BadAnswer("two units at once")
        await plant.clock.run_until(10.5)
        assert {r.quality for r in plant.readings} == {Quality.GOOD}
        plant.devices["c"].fault_once = BadAnswer("noise")
        await plant.clock.run_until(11.5)
    assert {r.quality for r in plant.readings} == {Quality.GOOD}


async def test_a_device_that_is_heard_is_asked_in_every_period_however_long_it_cannot_be_read() -> None:
    plant = five()
    plant.devices["c"].fault_takes_s = TAKES_S
    async with plant.running():
        await plant.clock.run_until(9.5)
        plant.devices["c"].fault = BadAnswer("noise")
        await plant.clock.run_until(99.5)
        faults = plant.of("c")[10:]
        assert {(r.quality, r.detail) for r in faults} == {(Quality.COMM_FAULT, "noise")}
        asks = [sum(second <= t < second + 1 for t in plant.devices["c"].asked) for second in range(10, 99)]
        assert asks == [8, 8, 8] + [2] * 86, "often while it may be a disturbance, then no longer"
        plant.devices["c"].fault = None
        await plant.clock.run_until(100.5)
        assert plant.of("c")[-1].quality is Quality.GOOD, "in the first period in which it can be read"
    assert plant.bus.opened == 1
    assert plant.told() == [("device c", False), ("device c", True)]
    for name in "abde":
        assert np.abs(intervals(plant, name) - 1.0).max() <= 0.2
        assert {r.quality for r in plant.of(name)} == {Quality.GOOD}


async def test_a_device_that_only_suffered_from_a_silent_one_is_asked_again_before_it() -> None:
    plant = five()
    async with plant.running():
        await plant.clock.run_until(9.5)
        plant.devices["a"].fault = NoAnswer("silent")
        plant.devices["b"].fault_once = BadAnswer("two units at once")
        await plant.clock.run_until(10.9)
    assert plant.of("a")[-1].quality is Quality.COMM_FAULT
    assert {r.quality for r in plant.of("b")} == {Quality.GOOD}


async def test_three_of_five_fall_silent_and_the_others_keep_their_period() -> None:
    plant = five()
    async with plant.running() as acquisition:
        await plant.clock.run_until(9.5)
        for name in "abc":
            plant.devices[name].fault = NoAnswer("silent")
        await plant.clock.run_until(40.5)
        for name in "abc":
            faults = [r.monotonic_s for r in plant.of(name) if r.quality is Quality.COMM_FAULT]
            assert faults[0] <= 10.0 + 3 * SHORT_S + 2 * TAKES_S + FULL_S + 1e-9
            assert len(faults) == 31
        assert acquisition.runners["rtu1"].missed == 0
    for name in "de":
        assert np.abs(intervals(plant, name) - 1.0).max() <= 3 * SHORT_S + 1e-9
        assert {r.quality for r in plant.of(name)} == {Quality.GOOD}


async def test_all_five_fall_silent_within_a_period_and_come_back_on_a_new_connection() -> None:
    plant = five()
    async with plant.running() as acquisition:
        await plant.clock.run_until(9.5)
        for device in plant.devices.values():
            device.fault = NoAnswer("silent")
        await plant.clock.run_until(10.9)
        assert plant.clock.monotonic() == pytest.approx(10.9), "it is over before the next period"
        assert not plant.bus.is_open, "half-open: nobody answers, so the connection is closed"
        assert [plant.of(name)[-1].quality for name in FIVE] == [Quality.COMM_FAULT] * 5
        for device in plant.devices.values():
            device.fault = None
        await plant.clock.run_until(11.5)
        assert acquisition.runners["rtu1"].missed == 0
    assert plant.bus.opened == 2
    assert [plant.of(name)[-1].quality for name in FIVE] == [Quality.GOOD] * 5


async def test_an_intermittent_device_is_asked_again_only_where_it_fits_into_the_period() -> None:
    plant = five()
    for device in plant.devices.values():
        device.takes_s, device.first_fault_takes_s = 0.1, 0.15
    async with plant.running() as acquisition:
        for second in (10, 20):
            await plant.clock.run_until(second - 0.5)
            for name in "ab":
                plant.devices[name].fault_once = NoAnswer("an answer was lost")
            await plant.clock.run_until(second + 0.5)
        assert acquisition.runners["rtu1"].missed == 0
    # 0.6 s have passed by then: less is left than a silent device may cost.
    for name in "ab":
        faults = [r.monotonic_s for r in plant.of(name) if r.quality is not Quality.GOOD]
        assert faults == pytest.approx([20.6]), "once is no fault, twice is"
        assert len([t for t in plant.devices[name].asked if 9.5 < t < 10.9]) == 2
    assert {r.quality for name in "cde" for r in plant.of(name)} == {Quality.GOOD}


async def test_a_fault_is_published_when_it_is_known_and_not_after_the_others() -> None:
    plant = five()
    plant.devices["a"].first_fault_takes_s = None  # at the start it is given all its time
    plant.devices["e"].takes_s = 0.3
    plant.devices["a"].fault = NoAnswer("silent")
    async with plant.running():
        await plant.clock.run_until(0.9)
    assert plant.of("a")[0].monotonic_s == pytest.approx(FULL_S)


async def test_an_intermittent_device_is_asked_last_until_it_has_been_steady() -> None:
    plant = five()
    async with plant.running(retry_max_periods=1):
        for second in range(1, 41):
            plant.devices["a"].fault = NoAnswer("silent") if second % 2 else None
            await plant.clock.run_until(second + 0.5)
        flapped_s = plant.clock.monotonic()
        plant.devices["a"].fault = None
        await plant.clock.run_until(flapped_s + 55.0)
        places = {t % 1.0 for t in plant.devices["a"].asked if flapped_s < t}
        assert min(places) == pytest.approx(4 * TAKES_S), "still behind the others"
        await plant.clock.run_until(flapped_s + 75.0)
    assert plant.devices["a"].asked[-1] % 1.0 == pytest.approx(0.0, abs=1e-6), "in its place again"
    for name in "bcde":
        assert np.abs(intervals(plant, name) - 1.0).max() <= SHORT_S + 1e-9


async def test_devices_that_recover_together_are_read_again_in_one_period() -> None:
    plant = five()
    for device in plant.devices.values():
        device.fault = NoAnswer("silent")
    async with plant.running(retry_max_periods=1):
        await plant.clock.run_until(5.5)
        for device in plant.devices.values():
            device.fault = None
        await plant.clock.run_until(6.5)
    assert [plant.of(name)[-1].quality for name in FIVE] == [Quality.GOOD] * 5


async def test_a_device_too_slow_for_the_period_is_reported_once_and_its_end_once() -> None:
    plant = five()
    async with plant.running() as acquisition:
        await plant.clock.run_until(9.5)
        plant.devices["c"].takes_s = 1.2
        await plant.clock.run_until(60.5)
        assert acquisition.runners["rtu1"].missed >= 20
        plant.devices["c"].takes_s = TAKES_S
        await plant.clock.run_until(80.5)
    assert plant.told() == [("period of bus rtu1", False), ("period of bus rtu1", True)]
    assert plant.notices[1].text == "period of bus rtu1: the devices answer in time again"
    text = plant.notices[0].text
    assert "bus rtu1: 2 of the last 12 periods of 1 s were missed" in text
    assert "take 1.3 s to answer, c alone 1.2 s (raise period_s" in text


async def test_one_slow_poll_and_silent_devices_are_not_reported_as_a_slow_bus() -> None:
    plant = five()
    async with plant.running() as acquisition:
        await plant.clock.run_until(9.5)
        plant.devices["c"].takes_s = 1.2
        await plant.clock.run_until(10.0)
        plant.devices["c"].takes_s = TAKES_S
        plant.devices["d"].fault = NoAnswer("silent")
        plant.devices["d"].first_fault_takes_s = plant.devices["d"].fault_takes_s = 3.0
        await plant.clock.run_until(100.5)
        assert acquisition.runners["rtu1"].missed > 3
    assert plant.told() == [("device d", False)]
