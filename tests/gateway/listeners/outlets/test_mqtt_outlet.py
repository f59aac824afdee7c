"""The MQTT outlet at Mosquitto, heard by its own client: topics, retained messages, last will, TLS, refusals."""

import asyncio
import json
from pathlib import Path

import pytest

from drivers.mqtt.connection import MqttConnection, Publication
from gateway.listeners.outlets.feed import Feed
from gateway.listeners.outlets.mqtt import MqttOutlet, MqttOutletSettings
from gateway.listeners.outlets.outlet import OutletError, OutletMessage
from tests.benches.cut_wire import wire_to
from tests.benches.feed_talk import heard, reading
from tests.benches.mosquitto import LIMIT_S, Mosquitto, Subscriber, made_password, mosquitto
from tests.benches.plant_authority import PlantAuthority

pytestmark = pytest.mark.peer

HERE = OutletMessage("mill", "alive", None)


def settings(url: str, **changes: object) -> MqttOutletSettings:
    fields: dict[str, object] = {"name": "plant", "kind": "mqtt", "url": url, "timeout_s": 60.0}
    return MqttOutletSettings.model_validate(fields | changes)


def test_states_are_retained_events_are_not_and_the_payload_is_the_published_one(tmp_path: Path) -> None:
    with mosquitto(tmp_path) as broker:
        outlet = MqttOutlet(settings(broker.url))
        outlet.open()
        sent = [HERE, heard("decision"), reading(1), heard("event", text="hot", seq=2), reading(3)]
        with Subscriber(broker, "talc/#") as live:
            live.until("talc/_outlet/plant", "online")
            outlet.send(sent)
            seen = live.until("talc/mill/reading/bed_front", sent[-1].payload.decode())
        assert seen["talc/mill/event"][0] == sent[3].payload.decode()
        with Subscriber(broker, "talc/#") as later:
            kept = later.until("talc/mill/reading/bed_front", sent[-1].payload.decode())
            while "talc/mill/decision" not in kept or "talc/mill/alive" not in kept:
                topic, payload, retained = later.next()
                kept[topic] = payload, retained
            outlet.close()
            goodbye = later.until("talc/_outlet/plant", "offline")
    assert kept["talc/mill/alive"] == ("online", True)
    assert kept["talc/mill/decision"] == (sent[1].payload.decode(), True)
    assert "talc/mill/event" not in kept | goodbye


def test_the_broker_says_offline_when_the_connection_is_lost(tmp_path: Path) -> None:
    with mosquitto(tmp_path) as broker:
        will = Publication("talc/_outlet/plant", b"offline", retained=True)
        connection = MqttConnection(settings(broker.url), LIMIT_S, will=will)
        connection.open()
        with Subscriber(broker, "talc/#") as live:
            connection.publish([Publication("talc/_outlet/plant", b"online", retained=True)])
            live.until("talc/_outlet/plant", "online")
            connection.drop()
            live.until("talc/_outlet/plant", "offline")


async def test_an_outlet_that_is_cut_off_is_offline_to_all_others(tmp_path: Path) -> None:
    with mosquitto(tmp_path) as broker, Subscriber(broker, "talc/#") as live:
        async with wire_to(broker.url) as (wire, joined):
            outlet = MqttOutlet(settings(f"mqtt://127.0.0.1:{joined.rpartition(':')[2]}"))
            await asyncio.to_thread(outlet.open)
            await asyncio.to_thread(live.until, "talc/_outlet/plant", "online")
            wire.abort()
            await asyncio.to_thread(live.until, "talc/_outlet/plant", "offline")
            await asyncio.to_thread(outlet.close)


def test_a_broker_that_comes_back_without_memory_gets_everything_retained_again(tmp_path: Path) -> None:
    broker = Mosquitto(tmp_path)
    broker.start()
    feed = Feed(settings(broker.url), MqttOutlet(settings(broker.url)))
    for each in (HERE, heard("measurement"), reading(1)):
        feed.put(each, 0.0)
    feed.turn(0.0)
    broker.stop()
    feed.put(reading(2), 0.0)
    due_s = feed.turn(0.0)
    assert feed.problem
    feed.put(reading(3), 0.0)
    broker.start()
    feed.turn(due_s)
    assert (feed.problem, feed.sent, feed.dropped) == ("", 5, 0)
    with Subscriber(broker, "talc/mill/#") as later:
        kept = {topic: (payload, retained) for topic, payload, retained in (later.next() for _ in range(3))}
    assert set(kept) == {"talc/mill/alive", "talc/mill/measurement", "talc/mill/reading/bed_front"}
    assert json.loads(kept["talc/mill/reading/bed_front"][0])["seq"] == 3
    feed.stop()
    feed.run()
    broker.stop()


def test_by_tls_with_a_user_and_a_certificate_and_each_refusal_says_why(tmp_path: Path) -> None:
    plant, other = PlantAuthority(tmp_path / "plant"), PlantAuthority(tmp_path / "other", "other")
    certificate, key = plant.issue("broker")
    mine, my_key = plant.issue("talc")
    password = tmp_path / "password"
    password.write_text("secret\n")
    wrong = tmp_path / "wrong"
    wrong.write_text("guess\n")
    with mosquitto(
        tmp_path,
        [
            f"cafile {plant.path}", f"certfile {certificate}", f"keyfile {key}", "require_certificate true",
            f"password_file {made_password(tmp_path, 'talc', 'secret')}",
        ],
    ) as broker:  # fmt: skip
        url = f"mqtts://127.0.0.1:{broker.port}"
        good = {"authority": plant.path, "certificate": mine, "key": my_key, "user": "talc", "password_file": password}
        outlet = MqttOutlet(settings(url, **good))
        outlet.open()
        outlet.send([reading(1)])
        outlet.close()
        for change, text in (
            ({"authority": other.path}, "its certificate is not accepted"),
            ({"password_file": wrong}, "refuses user 'talc'"),
            (dict(zip(("certificate", "key"), other.issue("talc"), strict=True)), "does the broker trust certificate"),
            ({"key": key}, "certificate: .* cannot be used"),
        ):
            with pytest.raises((OutletError, ValueError), match=text):
                MqttOutlet(settings(url, **good | change)).open()
        with pytest.raises(OutletError, match=r"mqtt://127\.0\.0\.1"):
            MqttOutlet(settings(broker.url)).open()


def test_home_assistant_finds_a_channel_with_its_unit_and_when_to_believe_it(tmp_path: Path) -> None:
    with mosquitto(tmp_path) as broker:
        outlet = MqttOutlet(settings(broker.url, home_assistant="homeassistant"))
        outlet.open()
        outlet.send([reading(1), reading(2), heard("decision")])
        outlet.close()
        with Subscriber(broker, "homeassistant/#") as later:
            found = {topic: json.loads(text) for topic, text, _ in (later.next() for _ in range(11))}
    channel = found["homeassistant/sensor/talc_mill/bed_front/config"]
    assert channel["state_topic"] == "talc/mill/reading/bed_front"
    assert (channel["unit_of_measurement"], channel["device_class"]) == ("°C", "temperature")
    assert [each["topic"] for each in channel["availability"]] == ["talc/mill/alive", "talc/_outlet/plant"]
    assert found["homeassistant/sensor/talc_mill/EA0C_corrected/config"]["unit_of_measurement"] == "µm/m"
    assert len({each["unique_id"] for each in found.values()}) == 11
    assert {each["origin"]["name"] for each in found.values()} == {"talc-gateway"}, "discovery without it is refused"
