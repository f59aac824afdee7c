"""Messages of an MQTT broker in a wire log: recorded by the driver, played again, heard by another maker's client."""

import asyncio
import subprocess
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import pytest

from drivers.base import Quality, SystemClock
from drivers.build import make_device
from drivers.mqtt.packets import publish_packet
from drivers.section import LONGEST_ANSWER_S
from gateway.acquisition.wire_log import WireEvent, WireLogWriter, read_wire_log
from gateway.demo.play import Played, play_bus
from tests.benches.buses import make_bus
from tests.benches.mosquitto import LIMIT_S, mosquitto

PROFILE = """
protocol = "mqtt"
title = "sensors of the hall"
unit = "degC"
max_age_s = 100
[[topic]]
topic = "hall/north"
[[topic]]
topic = "hall/south"
"""
NORTH, SOUTH, OTHER = ("hall/north", b"20.5", True), ("hall/south", b"21.5", False), ("yard/gate", b"open", False)


def recorded(*messages: tuple[str, bytes, bool]) -> list[WireEvent]:
    """A recording of messages a tenth of a second apart."""
    packets = [publish_packet(topic, payload, retained=kept) for topic, payload, kept in messages]
    return [
        WireEvent(0.0, "hall", "note", note="open"),
        *(WireEvent(0.1 * n, "hall", "received", packet) for n, packet in enumerate(packets)),
    ]


async def played(events: Sequence[WireEvent], folder: Path) -> Played:
    return await play_bus("hall", "mqtt", events, folder)


def test_a_message_is_the_packet_of_the_standard() -> None:
    """MQTT 3.1.1, 3.3 and 2.2.3: a topic a/b, and a length of more than 127 bytes."""
    assert publish_packet("a/b", b"", retained=False) == bytes.fromhex("30 05 00 03 61 2f 62")
    assert publish_packet("a/b", b"x", retained=True) == bytes.fromhex("31 06 00 03 61 2f 62 78")
    long = publish_packet("a/b", bytes(316), retained=False)
    assert long[:4] == bytes.fromhex("30 c1 02 00"), "321 = 65 + 2 * 128"
    with pytest.raises(ValueError, match="65536 bytes"):
        publish_packet("a" * 65536, b"", retained=False)


async def test_what_was_recorded_is_read_again_and_recorded_alike(tmp_path: Path) -> None:
    (tmp_path / "hall.toml").write_text(PROFILE)
    one = await played(recorded(NORTH, SOUTH, OTHER), tmp_path)
    path = tmp_path / "again.wire"
    try:
        with WireLogWriter(path, "", datetime.now(UTC), most_bytes=1_000_000) as log:
            bus = make_bus("hall", "mqtt", {**given(one), "timeout_s": LONGEST_ANSWER_S}, log.tap("hall"))
            device = make_device("sensors", bus, str(tmp_path / "hall.toml"), 1, {"n": 0, "s": 1}, {}, SystemClock())
            await bus.connect()
            readings = await device.read()
            await bus.close()
    finally:
        await one.stops.stop()
    kept, new = readings
    assert (kept.channel, kept.quality) == ("n", Quality.STALE), "the broker had kept it: nobody knows how old it is"
    assert (new.channel, new.quality, new.value) == ("s", Quality.GOOD, 21.5)
    again = read_wire_log(path).of("hall")
    assert [event.note for event in again if event.passed == "note"] == ["open", "close"]
    assert [event.data for event in again if event.passed == "received"] == [
        publish_packet(topic, payload, retained=kept) for topic, payload, kept in (NORTH, SOUTH)
    ]


def given(one: Played) -> dict[str, object]:
    return {field: value for field, value in one.place.items() if value is not None}


@pytest.mark.peer
async def test_another_makers_client_hears_the_played_messages_again_and_again(tmp_path: Path) -> None:
    """The messages of its topics; those that the broker had kept come only once."""
    one = await played(recorded(NORTH, SOUTH, OTHER), tmp_path)
    _, _, port = str(one.place["url"]).rpartition(":")
    command = ["mosquitto_sub", "-h", "127.0.0.1", "-p", port, "-t", "hall/+", "-C", "3", "-F", "%t %p %r"]
    try:
        done = await asyncio.to_thread(
            subprocess.run, command, check=True, timeout=LIMIT_S, capture_output=True, text=True
        )
    finally:
        await one.stops.stop()
    assert done.stdout.splitlines() == ["hall/north 20.5 1", "hall/south 21.5 0", "hall/south 21.5 0"]


@pytest.mark.peer
async def test_a_real_brokers_messages_are_recorded(tmp_path: Path) -> None:
    (tmp_path / "hall.toml").write_text(PROFILE)
    path = tmp_path / "field.wire"
    with mosquitto(tmp_path) as broker:
        say = ["mosquitto_pub", "-h", "127.0.0.1", "-p", str(broker.port), "-q", "1", "-r"]
        for topic, payload in (("hall/north", "20.5"), ("hall/south", "21.5")):
            await asyncio.to_thread(subprocess.run, [*say, "-t", topic, "-m", payload], check=True, timeout=LIMIT_S)
        with WireLogWriter(path, "", datetime.now(UTC), most_bytes=1_000_000) as log:
            bus = make_bus("hall", "mqtt", {"url": broker.url, "timeout_s": LONGEST_ANSWER_S}, log.tap("hall"))
            device = make_device("sensors", bus, str(tmp_path / "hall.toml"), 1, {"n": 0, "s": 1}, {}, SystemClock())
            await bus.connect()
            await device.read()
            await bus.close()
    received = {event.data for event in read_wire_log(path).events if event.passed == "received"}
    assert [event.note for event in read_wire_log(path).events if event.passed == "note"] == ["open", "close"]
    assert received == {
        publish_packet("hall/north", b"20.5", retained=True),
        publish_packet("hall/south", b"21.5", retained=True),
    }
