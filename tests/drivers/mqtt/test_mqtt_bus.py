"""Topics of a real broker as channels: retained messages, ages, faults, loss and return."""

import asyncio
import subprocess
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from drivers.base import Clock, ConnectError, Driver, Quality, Reading, SystemClock
from drivers.build import make_device
from drivers.mqtt.bus import MqttBus
from drivers.section import LONGEST_ANSWER_S
from tests.benches.buses import make_bus
from tests.benches.mosquitto import LIMIT_S, Mosquitto, mosquitto
from tests.benches.refusals import refusing, summary

pytestmark = pytest.mark.peer

PROFILE = """
protocol = "mqtt"
title = "sensors of the plant"
unit = "degC"
max_age_s = 100
[[topic]]
topic = "plant/timed"
number = "t"
time = "at"
[[topic]]
topic = "plant/plain"
[[topic]]
topic = "plant/never"
"""


def say(broker: Mosquitto, topic: str, payload: str, *more: str) -> None:
    command = ["mosquitto_pub", "-h", "127.0.0.1", "-p", str(broker.port), "-q", "1", "-t", topic, "-m", payload, *more]
    subprocess.run(command, check=True, timeout=LIMIT_S)


def timed(value: float, age_s: float) -> str:
    return f'{{"t": {value}, "at": "{(datetime.now(UTC) - timedelta(seconds=age_s)).isoformat()}"}}'


def site(
    broker: Mosquitto,
    tmp_path: Path,
    names: dict[str, int],
    timeout_s: float,
    clock: Clock | None = None,
    max_age_s: float = 100,
) -> tuple[MqttBus, Driver]:
    profile = tmp_path / "plant.toml"
    profile.write_text(PROFILE.replace("max_age_s = 100", f"max_age_s = {max_age_s}"))
    bus = make_bus("broker", "mqtt", {"url": broker.url, "timeout_s": timeout_s})
    assert isinstance(bus, MqttBus)
    return bus, make_device("plant", bus, str(profile), 1, names, {}, clock or SystemClock())


async def until(driver: Driver, quality: Quality, value: float | None = None, detail: str = "") -> Reading:
    """The first channel, once a condition holds: the broker passes messages on a moment after it accepted them."""
    async with asyncio.timeout(LIMIT_S):
        while True:
            (found, *_) = await driver.read()
            if found.quality is quality and (value is None or found.value == value) and detail in found.detail:
                return found
            await asyncio.sleep(0.01)


async def test_the_payloads_time_is_the_age_also_of_what_the_broker_kept(tmp_path: Path) -> None:
    with mosquitto(tmp_path) as broker:
        say(broker, "plant/timed", timed(20.5, 60.0), "-r")
        bus, driver = site(broker, tmp_path, {"timed": 0}, LONGEST_ANSWER_S)
        try:
            await bus.connect()
            await driver.connect()
            (kept,) = await driver.read()
            now = datetime.now(UTC)
            assert (kept.value, kept.unit, kept.quality) == (20.5, "degC", Quality.GOOD)
            assert timedelta(seconds=59) < now - kept.source_time < timedelta(seconds=60 + LIMIT_S)
            say(broker, "plant/timed", timed(20.7, 150.0))
            assert (await until(driver, Quality.STALE)).detail.endswith("s old by the payload's own time")
            say(broker, "plant/timed", timed(20.7, -150.0))
            await until(driver, Quality.STALE, detail="ahead of this computer's clock")
            say(broker, "plant/timed", "broken")
            assert "neither a number nor JSON" in (await until(driver, Quality.SENSOR_FAULT)).detail
            say(broker, "plant/timed", timed(21.0, 0.0))
            await until(driver, Quality.GOOD, 21.0)
        finally:
            await bus.close()


class StoppedClock(SystemClock):
    """Its time of day stands still, like that of a clock which is ahead and is set back again and again."""

    def __init__(self) -> None:
        self._utc = datetime.now(UTC)

    def utc(self) -> datetime:
        return self._utc


async def test_a_value_is_not_younger_than_its_arrival_whatever_the_clocks_say(tmp_path: Path) -> None:
    with mosquitto(tmp_path) as broker:
        bus, driver = site(broker, tmp_path, {"timed": 0}, LONGEST_ANSWER_S, StoppedClock(), max_age_s=1)
        try:
            await bus.connect()
            say(broker, "plant/timed", timed(20.5, 0.0))
            await until(driver, Quality.STALE, detail="s old by the arrival of the last message")
        finally:
            await bus.close()


async def test_without_a_time_a_kept_message_has_an_unknown_age_and_a_new_one_is_fresh(tmp_path: Path) -> None:
    with mosquitto(tmp_path) as broker:
        say(broker, "plant/plain", "19.5", "-r")
        bus, driver = site(broker, tmp_path, {"plain": 1}, LONGEST_ANSWER_S)
        try:
            await bus.connect()
            (kept,) = await driver.read()
            assert (kept.quality, "the age is unknown" in kept.detail) == (Quality.STALE, True)
            say(broker, "plant/plain", "19.6", "-r")
            await until(driver, Quality.GOOD, 19.6)
        finally:
            await bus.close()


async def test_a_topic_that_is_silent_is_its_own_channels_fault(tmp_path: Path) -> None:
    with mosquitto(tmp_path) as broker:
        say(broker, "plant/timed", timed(20.5, 0.0), "-r")
        bus, driver = site(broker, tmp_path, {"timed": 0, "never": 2}, 5.0)
        try:
            await bus.connect()
            await until(driver, Quality.GOOD)
            _, never = await driver.read()
            assert (never.quality, never.detail) == (
                Quality.COMM_FAULT,
                "no message of topic plant/never has arrived yet",
            )
        finally:
            await bus.close()


async def test_a_broker_that_goes_ends_the_read_and_the_next_connect_finds_it_again(tmp_path: Path) -> None:
    broker = Mosquitto(tmp_path)
    broker.start()
    say(broker, "plant/timed", timed(20.5, 0.0), "-r")
    bus, driver = site(broker, tmp_path, {"timed": 0}, LONGEST_ANSWER_S)
    try:
        await bus.connect()
        await until(driver, Quality.GOOD)
        broker.stop()
        with pytest.raises(ConnectError) as lost:
            await until(driver, Quality.STALE)
        assert {"mqtt_lost", "mqtt_not_open"} & {*summary(lost.value).split()}
        with refusing(ConnectError, "mqtt_not_open mqtt_running"):
            await bus.connect()
        broker.start()
        await bus.connect()
        say(broker, "plant/timed", timed(21.5, 0.0))
        await until(driver, Quality.GOOD, 21.5)
    finally:
        await bus.close()
        broker.stop()


async def test_the_rest_of_a_payload_that_is_too_long_is_not_kept(tmp_path: Path) -> None:
    with mosquitto(tmp_path) as broker:
        bus, driver = site(broker, tmp_path, {"plain": 1}, LONGEST_ANSWER_S)
        try:
            await bus.connect()
            say(broker, "plant/plain", "1" * 100_000)
            await until(driver, Quality.SENSOR_FAULT, detail="the payload has more than 65536 bytes")
            assert len((await bus.latest("plant", ["plant/plain"]))["plant/plain"].payload) == 65_537
            say(broker, "plant/plain", "19.6")
            await until(driver, Quality.GOOD, 19.6)
        finally:
            await bus.close()


async def test_mosquittos_limit_keeps_long_messages_from_the_gateway(tmp_path: Path) -> None:
    with mosquitto(tmp_path, ["allow_anonymous true", "message_size_limit 65536"]) as broker:
        bus, driver = site(broker, tmp_path, {"plain": 1}, LONGEST_ANSWER_S)
        try:
            await bus.connect()
            say(broker, "plant/plain", "1" * 100_000)
            say(broker, "plant/plain", "19.6")
            (found,) = await driver.read()
            assert (found.quality, found.value) == (Quality.GOOD, 19.6)
        finally:
            await bus.close()
