"""A value that is no longer renewed: the board reports it as stale, even while a read hangs."""

import asyncio
import math
from collections.abc import Sequence

import pytest

from drivers.base import Quality, Reading
from gateway.acquisition.acquisition import Acquisition
from gateway.acquisition.board import Board
from gateway.config.file import parse
from gateway.control.restart.earlier import EarlierRun
from gateway.model.events import GatewayEvent, ReadingsTaken
from gateway.model.sample import Sample
from gateway.runtime.clocks import RealClock
from gateway.service.service import Service
from simulators.devices import Adam6015, TcpHost
from talc.control import Controller
from tests.benches.scripted_bus import ScriptedPlant
from tests.benches.service_file import FILE
from tests.benches.stepped_clock import EPOCH

pytestmark = pytest.mark.simulated_time

PERIOD_S = 0.2
LATE_S = 1.2
TEXT = """
[machine]
name = "mill"
[[bus]]
name = "tcp1"
kind = "modbus_tcp"
host = "127.0.0.1"
port = {port}
period_s = {period_s}
timeout_s = 5.0
[[device]]
name = "adam"
bus = "tcp1"
profile = "advantech_adam6015"
[device.channels]
bed = 0
column = 1
"""


def reading(channel: str, at_s: float, quality: Quality = Quality.GOOD) -> Reading:
    return Reading(channel, 20.0, "degC", quality, EPOCH, at_s)


def test_the_board_lets_values_age() -> None:
    board = Board({"a_t": 2.0})
    assert board.latest("a_t", 0.0) is None
    board.put([reading("a_t", 10.0)])
    fresh, old = board.latest("a_t", 15.5), board.latest("a_t", 16.0)
    assert fresh is not None
    assert old is not None
    assert (fresh.age_s, fresh.reading.quality) == (5.5, Quality.GOOD)
    assert (old.age_s, old.reading.quality, old.reading.detail) == (6.0, Quality.STALE, "no new value for 6.0 s")
    assert math.isnan(old.reading.value)
    with pytest.raises(KeyError, match="stranger"):
        board.put([reading("stranger", 0.0)])


def test_a_value_expires_once_and_what_is_bad_does_not() -> None:
    board = Board({"fast": 1.0, "slow": 4.0, "broken": 1.0})
    board.put([reading("fast", 10.0), reading("slow", 10.0), reading("broken", 10.0, Quality.SENSOR_FAULT)])
    assert board.expire(10.5) == ([], 13.0), "fast goes stale first"
    gone, again_s = board.expire(13.0)
    assert [(r.channel, r.quality, r.monotonic_s) for r in gone] == [("fast", Quality.STALE, 10.0)]
    assert again_s == 16.0, "what comes in a moment may go stale then"
    board.put([reading("fast", 19.5)])
    gone, again_s = board.expire(22.2)
    assert ([r.channel for r in gone], again_s) == (["slow"], 22.5)
    assert [r.channel for r in board.expire(22.5)[0]] == ["fast"], "again, after a new value"
    board.put([reading("slow", 30.0)])
    board.configure({"fast": 1.0, "slow": 0.5})
    assert [r.channel for r in board.expire(31.5)[0]] == ["slow"], "by its new period"


async def test_every_channel_of_a_hanging_bus_is_reported_stale_once() -> None:
    plant, told = ScriptedPlant("a", "b"), list[tuple[float, Sample]]()

    def publish(readings: Sequence[Sample]) -> None:
        told.extend((plant.clock.monotonic(), r) for r in readings)

    async with Acquisition([plant.line()], plant.clock, publish, lambda _: None):
        for second in range(40):
            if second == 10:
                plant.devices["a"].hang = True
            await plant.clock.run_until(float(second))
    stale = [(at, r) for at, r in told if r.quality is Quality.STALE]
    assert [(at, r.channel, r.monotonic_s) for at, r in stale] == [(12.0, "a_t", 9.0), (12.0, "b_t", 9.0)]
    assert all(math.isnan(r.value) for _, r in stale)
    numbers = {r.sequence for _, r in told if r.quality is not Quality.STALE}
    assert not numbers & {r.sequence for _, r in stale}, "no number is used twice"


class TimedSink:
    """A sink that keeps readings and when they came, monotonic s."""

    def __init__(self, clock: RealClock) -> None:
        self._clock = clock
        self.at: list[tuple[float, Reading]] = []

    def __call__(self, event: GatewayEvent) -> None:
        if isinstance(event, ReadingsTaken):
            self.at.extend((self._clock.monotonic(), r) for r in event.readings)


async def test_the_service_reports_a_stale_value_while_the_read_hangs() -> None:
    """The answer comes late, but within the timeout: only the age shows it."""
    host = TcpHost({1: Adam6015(lambda: [20.0, 30.0, *[0.0] * 5])})
    config = parse(TEXT.format(port=await host.start(), period_s=PERIOD_S), FILE)
    clock, stop = RealClock(), asyncio.Event()
    heard = TimedSink(clock)
    service = Service(config, clock, heard, EarlierRun(Controller(config.input_names, config.talc)))
    running = asyncio.create_task(service.run(stop))

    async def until(quality: Quality, after: int) -> int:
        """The position of the first reading of bed with this quality."""
        async with asyncio.timeout(60.0):
            while True:
                for position, (_, r) in enumerate(heard.at):
                    if position >= after and (r.channel, r.quality) == ("bed", quality):
                        return position
                await asyncio.sleep(0.005)

    try:
        good = await until(Quality.GOOD, 0)
        host.spoil = lambda _, frame: ((LATE_S, frame),)
        stale = await until(Quality.STALE, good)
        host.spoil = None
        again = await until(Quality.GOOD, stale)
        assert next(iter(service.periods_missed().values())) >= 2, "they are counted, for the status"
        [[answer_s]] = [of.values() for of in service.answers_s().values()]
        assert 0.0 < answer_s < LATE_S
    finally:
        stop.set()
        await running
        await host.stop()
    of_bed = [(at, r) for at, r in heard.at[: again + 1] if r.channel == "bed"]
    assert [r.quality for _, r in of_bed][-3:] == [Quality.GOOD, Quality.STALE, Quality.GOOD]
    (_, last), (told_s, gone), (came_s, _) = of_bed[-3:]
    assert math.isnan(gone.value)
    assert 3 * PERIOD_S <= told_s - last.monotonic_s < 3 * PERIOD_S + 0.2, "two periods after it should have come"
    assert told_s < came_s
    assert (gone.monotonic_s, gone.source_time) == (last.monotonic_s, last.source_time)
    assert {r.quality for _, r in heard.at} == {Quality.GOOD, Quality.STALE}
