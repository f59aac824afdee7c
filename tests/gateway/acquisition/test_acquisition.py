"""The runners of the buses: schedule, faults, recovery, neighbours. The drivers here are scripts, not devices."""

import asyncio
import logging
import math
from collections import Counter
from collections.abc import Sequence

import pytest

from drivers.base import BadAnswer, ConnectError, NoAnswer, Quality, Reading, WrongDevice
from gateway.acquisition.acquisition import Acquisition
from gateway.config.sections import Limits
from tests.benches.scripted_bus import ScriptedDevice, ScriptedPlant


async def test_every_device_is_read_once_a_period_without_drift() -> None:
    plant = ScriptedPlant("a", "b")
    plant.devices["a"].takes_s = 0.03
    plant.devices["b"].takes_s = 0.04
    async with plant.running():
        await plant.clock.run_until(100.5)
    assert len(plant.of("a")) == len(plant.of("b")) == 101
    assert plant.devices["a"].asked == pytest.approx(list(range(101)))
    assert all(r.quality is Quality.GOOD for r in plant.readings)
    assert plant.notices == []


async def test_a_phase_shifts_all_polls_but_the_first() -> None:
    plant = ScriptedPlant("a")
    async with plant.running(phase_s=0.25):
        await plant.clock.run_until(10.0)
    assert plant.devices["a"].asked == pytest.approx([0.0, *(0.25 + k for k in range(10))])


async def test_sequence_numbers_tell_every_reading_of_a_channel_apart() -> None:
    plant = ScriptedPlant("a", "b")
    async with plant.running():
        await plant.clock.run_until(10.0)
        plant.devices["a"].fault = NoAnswer("silent")
        await plant.clock.run_until(20.0)
    for device in ("a", "b"):
        numbers = [r.sequence for r in plant.of(device)]
        assert numbers == sorted(set(numbers))


async def test_a_silent_device_gets_faults_its_neighbour_keeps_its_period_and_both_ends_are_reported_once() -> None:
    plant = ScriptedPlant("a", "b")
    a, b = plant.devices.values()
    async with plant.running():
        await plant.clock.run_until(9.5)
        a.fault = NoAnswer("no answer within 0.5 s", bus="rtu1", device="a")
        await plant.clock.run_until(39.5)
        assert plant.of("a")[10].quality is Quality.COMM_FAULT, "the first period without an answer shows it"
        a.fault = None
        await plant.clock.run_until(60.5)
    assert b.asked == pytest.approx(list(range(61)))
    assert {r.quality for r in plant.of("b")} == {Quality.GOOD}
    assert len(plant.of("a")) == 61, "missing data is an explicit reading"
    faulty = [r for r in plant.of("a") if r.quality is Quality.COMM_FAULT]
    assert all(math.isnan(r.value) and r.unit == "degC" and "no answer" in r.detail for r in faulty)
    asked = [t for t in a.asked if 9.5 < t < 60]
    often = [second for second in (10, 11, 13) for _ in range(4)]
    assert asked[:16] == pytest.approx([*often, 17, 25, 33, 41]), "four times while it may be a disturbance"
    assert plant.of("a")[-1].quality is Quality.GOOD
    assert plant.told() == [("device a", False), ("device a", True)]


async def test_a_dead_device_that_costs_most_of_a_period_is_asked_only_where_it_fits() -> None:
    plant = ScriptedPlant("dead", "b")
    dead, b = plant.devices.values()
    dead.fault, dead.fault_takes_s, b.takes_s = NoAnswer("silent"), 0.7, 0.2
    async with plant.running():
        await plant.clock.run_until(200.5)
    # Only the very first question, when nobody knew yet, comes before the neighbour's.
    late = [t % 1.0 for t in b.asked[1:]]
    assert max(min(phase, 1 - phase) for phase in late) < 1e-6
    assert len(b.asked) == 201


async def test_a_dead_device_is_asked_where_a_period_has_room_for_half_of_itself_however_long_the_timeout() -> None:
    plant = ScriptedPlant("a", "b")
    plant.bus.timeout_s = 3.0
    plant.devices["b"].fault_takes_s = 0.3
    async with plant.running():
        await plant.clock.run_until(5.5)
        plant.devices["b"].fault = NoAnswer("silent")
        await plant.clock.run_until(29.5)
        asked = sorted({int(t) for t in plant.devices["b"].asked if t > 5.5})
    assert asked == [6, 7, 9, 13, 21, 29], "after 1, 2, 4, 8 and 8 periods"


async def test_a_dead_device_that_never_fits_is_asked_at_last_and_rarely() -> None:
    plant = ScriptedPlant("dead", "b")
    dead, b = plant.devices.values()
    dead.fault, dead.fault_takes_s = NoAnswer("silent"), 1.5
    async with plant.running():
        await plant.clock.run_until(200.5)
    assert 10 <= len(dead.asked) <= 16
    assert len(b.asked) >= 201 - 2 * len(dead.asked)


async def test_one_of_many_dead_devices_is_tried_per_period() -> None:
    plant = ScriptedPlant("b", *(f"dead{i}" for i in range(6)))
    for name, device in plant.devices.items():
        if name != "b":
            device.fault = NoAnswer("silent")
    async with plant.running():
        await plant.clock.run_until(100.5)
    tries = Counter(math.floor(t) for name, d in plant.devices.items() if name != "b" for t in d.asked if t > 0.5)
    assert max(tries.values()) == 1
    assert min(len(d.asked) for d in plant.devices.values()) >= 8, "each has its turn"


async def test_the_longest_waiting_of_many_dead_devices_is_tried_first() -> None:
    plant = ScriptedPlant("b", *(f"dead{i}" for i in range(7)))
    for name, device in plant.devices.items():
        if name != "b":
            device.fault, device.fault_takes_s = NoAnswer("silent"), 0.3
    async with plant.running():
        await plant.clock.run_until(300.0)
    tries = [len(device.asked) for name, device in plant.devices.items() if name != "b"]
    assert max(tries) - min(tries) <= 1


async def test_a_bus_that_does_not_open_is_tried_without_end_and_reported_once() -> None:
    plant = ScriptedPlant("a")
    plant.bus.fault = ConnectError("no such port", bus="rtu1")
    async with plant.running():
        await plant.clock.run_until(100.0)
        assert plant.bus.opened == 0
        assert len(plant.of("a")) == 101
        assert {r.quality for r in plant.of("a")} == {Quality.COMM_FAULT}
        assert "no such port" in plant.of("a")[0].detail
        plant.bus.fault = None
        await plant.clock.run_until(109.0)
        assert plant.of("a")[-1].quality is Quality.GOOD, "within the longest wait, without anybody's help"
    assert plant.told() == [("bus rtu1", False), ("bus rtu1", True)]


async def test_when_nobody_answers_the_connection_is_opened_again() -> None:
    plant = ScriptedPlant("a", "b")
    async with plant.running():
        await plant.clock.run_until(5.5)
        for device in plant.devices.values():
            device.fault = NoAnswer("silent")  # a half-open connection: sending works, nothing comes
        await plant.clock.run_until(6.5)
        assert not plant.bus.is_open
        for device in plant.devices.values():
            device.fault = None
        await plant.clock.run_until(10.0)
        assert plant.bus.opened == 2
        assert plant.of("a")[-1].quality is plant.of("b")[-1].quality is Quality.GOOD


async def test_a_lost_connection_gives_every_channel_of_the_bus_a_fault_and_comes_back() -> None:
    plant = ScriptedPlant("a", "b")
    async with plant.running():
        await plant.clock.run_until(5.5)
        plant.devices["a"].fault = ConnectError("connection reset", bus="rtu1")
        plant.bus.fault = ConnectError("host unreachable", bus="rtu1")
        await plant.clock.run_until(6.5)
        assert [r.quality for r in plant.readings[-2:]] == [Quality.COMM_FAULT] * 2
        assert all("connection reset" in r.detail for r in plant.readings[-2:])
        plant.devices["a"].fault = plant.bus.fault = None
        await plant.clock.run_until(20.0)
    assert [r.quality for r in plant.readings[-2:]] == [Quality.GOOD] * 2
    assert len(plant.of("a")) == len(plant.of("b")) == 21
    # The bus opened at the first attempt, so nothing was reported about it; b was not asked on a closed bus.
    assert plant.told() == [("device a", False), ("device a", True)]


async def test_a_connection_that_is_lost_while_a_heard_device_is_asked_again_is_opened_again() -> None:
    plant = ScriptedPlant("a", "b")
    async with plant.running():
        await plant.clock.run_until(5.5)
        plant.devices["b"].fault_once = BadAnswer("noise")
        plant.devices["b"].fault_then = ConnectError("connection reset", bus="rtu1")
        await plant.clock.run_until(6.5)
        assert not plant.bus.is_open
        assert "connection reset" in plant.of("b")[-1].detail
        plant.devices["b"].fault = None
        await plant.clock.run_until(8.5)
    assert plant.bus.opened == 2
    assert plant.of("a")[-1].quality is plant.of("b")[-1].quality is Quality.GOOD


async def test_a_bus_that_does_not_open_is_closed_so_that_nothing_of_the_attempt_remains() -> None:
    plant = ScriptedPlant("a")
    plant.bus.fault = ConnectError("refused after the connection was made", bus="rtu1")
    async with plant.running():
        await plant.clock.run_until(0.5)
        assert plant.bus.closed == 1


async def test_a_bus_that_was_open_is_tried_again_soon_however_long_it_once_was_away() -> None:
    plant = ScriptedPlant("a")
    away = ConnectError("host unreachable", bus="rtu1")
    plant.bus.fault = away
    async with plant.running():
        await plant.clock.run_until(20.5)  # by now 8 periods pass between two attempts
        plant.bus.fault = None
        await plant.clock.run_until(40.5)
        plant.devices["a"].fault_once, plant.bus.fault = ConnectError("connection reset", bus="rtu1"), away
        await plant.clock.run_until(42.5)
        plant.bus.fault = None
        await plant.clock.run_until(44.5)
        assert plant.of("a")[-1].quality is Quality.GOOD


async def test_the_first_error_that_had_its_full_time_says_what_is_wrong() -> None:
    plant = ScriptedPlant("a", "b")
    plant.devices["b"].first_fault_takes_s = 0.01
    async with plant.running():
        await plant.clock.run_until(5.5)
        plant.devices["b"].fault_once = NoAnswer("not within 0.01 s")
        plant.devices["b"].fault_then = BadAnswer("noise")
        await plant.clock.run_until(6.5)
        plant.devices["b"].fault = None
        await plant.clock.run_until(7.5)
        plant.devices["b"].fault_once, plant.devices["b"].fault_then = BadAnswer("noise"), NoAnswer("silent")
        await plant.clock.run_until(8.5)
    assert [r.detail for r in plant.of("b")[6:]] == ["noise", "", "noise"]


async def test_a_fault_that_comes_again_is_reported_again() -> None:
    plant = ScriptedPlant("a")
    async with plant.running():
        for until in (10.5, 20.5, 30.5, 40.5):
            await plant.clock.run_until(until)
            plant.devices["a"].fault = NoAnswer("silent") if plant.devices["a"].fault is None else None
        await plant.clock.run_until(60.0)
    assert plant.told() == [("device a", False), ("device a", True)] * 2


async def test_problems_that_take_turns_are_each_reported_once() -> None:
    plant = ScriptedPlant("a")
    async with plant.running(retry_max_periods=1):
        for until in range(5, 40):
            plant.devices["a"].fault = NoAnswer("silent") if until % 2 else BadAnswer("noise")
            await plant.clock.run_until(until + 0.5)
        plant.devices["a"].fault = None
        await plant.clock.run_until(45.0)
    assert plant.told() == [("device a", False)] * 2 + [("device a", True)]


async def test_a_loose_contact_fills_neither_the_log_nor_the_events(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, logger="gateway.acquisition.runner")
    plant = ScriptedPlant("a", "b")
    async with plant.running():
        for second in range(600):
            plant.devices["a"].quality = Quality.SENSOR_FAULT if second % 2 else Quality.GOOD
            plant.devices["b"].fault = NoAnswer("silent") if second % 3 == 0 else None
            await plant.clock.run_until(second + 0.5)
        plant.devices["a"].quality, plant.devices["b"].fault = Quality.GOOD, None
        await plant.clock.run_until(720.0)
    assert {r.quality for r in plant.of("a")} == {Quality.GOOD, Quality.SENSOR_FAULT}
    for subject in ("channel a_t", "device b"):
        told = [(notice.ended, "intermittent" in notice.text) for notice in plant.notices if notice.subject == subject]
        assert told == [(False, False), (True, False)] * 3 + [(False, True), (True, False)]
    assert len(caplog.records) == len(plant.notices)


async def test_a_device_that_returns_is_connected_again_so_that_its_type_is_checked() -> None:
    plant = ScriptedPlant("a", "b")
    a = plant.devices["a"]
    async with plant.running():
        await plant.clock.run_until(5.5)
        a.fault = NoAnswer("silent")
        await plant.clock.run_until(6.5)
        a.fault, a.fault_at_connect = None, WrongDevice("type code 0x20, expected 0x2A", device="a")
        await plant.clock.run_until(30.5)
        assert plant.of("a")[-1].quality is Quality.COMM_FAULT
        assert "type code" in plant.of("a")[-1].detail
        a.fault_at_connect = None
        await plant.clock.run_until(50.0)
    assert plant.of("a")[-1].quality is Quality.GOOD
    # Silence became another problem: both are reported, and one end.
    assert plant.told() == [("device a", False), ("device a", False), ("device a", True)]


async def test_an_unexpected_error_stays_with_its_device_and_shows_its_traceback_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    plant = ScriptedPlant("a", "b")
    plant.devices["a"].fault = ZeroDivisionError("division by zero")
    async with plant.running():
        await plant.clock.run_until(50.0)
    assert {r.quality for r in plant.of("b")} == {Quality.GOOD}
    assert "unexpected ZeroDivisionError" in plant.of("a")[-1].detail
    records = [r for r in caplog.records if r.levelno >= logging.WARNING]
    assert len(records) == 1
    assert records[0].exc_info is not None


async def test_a_read_that_hangs_is_cut_and_the_bus_opened_again() -> None:
    plant = ScriptedPlant("a", "b")
    async with plant.running(read_limit_s=0.05):
        await plant.clock.run_until(3.5)
        plant.devices["a"].hang = True
        await plant.clock.run_until(4.0)
        async with asyncio.timeout(60.0):
            while not plant.notices:
                await asyncio.sleep(0.01)
        plant.devices["a"].hang = False
        await plant.clock.run_until(10.0)
    assert plant.told()[0] == ("device a", False)
    assert "did not finish within 0.05 s" in plant.notices[0].text
    assert plant.bus.opened >= 2
    assert plant.of("b")[-1].quality is Quality.GOOD


async def test_a_sensor_fault_is_reported_once_and_is_no_fault_of_the_device() -> None:
    plant = ScriptedPlant("a")
    async with plant.running():
        await plant.clock.run_until(3.5)
        plant.devices["a"].quality = Quality.SENSOR_FAULT
        await plant.clock.run_until(20.5)
        plant.devices["a"].quality = Quality.GOOD
        await plant.clock.run_until(30.0)
    assert plant.told() == [("channel a_t", False), ("channel a_t", True)]
    assert len(plant.devices["a"].asked) == 31


async def test_stated_limits_are_judged() -> None:
    plant = ScriptedPlant("a", "b")
    plant.plausible["a_t"] = Limits(max=20.0095)
    async with plant.running():
        await plant.clock.run_until(20.0)
    assert [r.quality for r in plant.of("a")] == [Quality.GOOD] * 10 + [Quality.OUT_OF_RANGE] * 11
    assert {r.quality for r in plant.of("b")} == {Quality.GOOD}


async def test_periods_that_were_missed_are_counted_and_not_caught_up() -> None:
    plant = ScriptedPlant("a")
    plant.devices["a"].takes_s = 2.5
    async with plant.running() as acquisition:
        await plant.clock.run_until(30.5)
    assert plant.devices["a"].asked == pytest.approx([3.0 * n for n in range(11)])
    assert acquisition.runners["rtu1"].missed == 2 * 11


async def test_leaving_closes_everything() -> None:
    plant = ScriptedPlant("a")
    async with plant.running():
        await plant.clock.run_until(3.0)
    assert not plant.bus.is_open
    assert plant.clock.holds == 0


async def test_an_error_in_the_service_itself_ends_it_as_a_group() -> None:
    plant = ScriptedPlant("a")

    def refuse(readings: Sequence[Reading]) -> None:
        raise OverflowError("queue full")

    async def serve() -> None:
        async with Acquisition([plant.line()], plant.clock, refuse, plant.notices.append):
            await plant.clock.run_until(5.0)
            await asyncio.Event().wait()

    with pytest.raises(ExceptionGroup) as caught:
        await serve()
    assert caught.group_contains(OverflowError, match="queue full")
    assert not plant.bus.is_open


async def test_one_bus_is_exchanged_and_the_other_notices_nothing() -> None:
    plant, other = ScriptedPlant("a"), ScriptedPlant("b")
    other.clock, other.bus.name = plant.clock, "tcp1"
    other.devices = {"b": ScriptedDevice("b", plant.clock, other.bus)}
    new = ScriptedPlant("a")
    new.devices = {"a": ScriptedDevice("a", plant.clock, new.bus)}
    lines = [plant.line(), other.line()]
    async with Acquisition(lines, plant.clock, plant.readings.extend, plant.notices.append) as acquisition:
        kept = acquisition.runners["tcp1"]
        await plant.clock.run_until(5.5)
        await acquisition.exchange(["rtu1"], [new.line()])
        assert not plant.bus.is_open
        await plant.clock.run_until(10.0)
        assert acquisition.runners["tcp1"] is kept
    assert other.bus.opened == new.bus.opened == 1
    assert other.devices["b"].asked == pytest.approx(list(range(11)))
    assert plant.devices["a"].asked == pytest.approx(list(range(6)))
    assert new.devices["a"].asked == pytest.approx([5.5, 6.5, 7.5, 8.5, 9.5])
    numbers = [r.sequence for r in plant.of("a")]
    assert numbers == sorted(set(numbers)), "the sequence goes on"
    assert plant.notices == []
