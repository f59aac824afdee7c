"""`inspect topics`: what payloads may mean, and a draft with which the gateway reads the same values."""

import json
import math
import subprocess
from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from drivers.mqtt.bus import TopicMessage
from drivers.mqtt.profile import MqttProfile
from drivers.profiles import load_profile
from gateway.cli.main import main
from gateway.commissioning.scan.topics import SeenTopic, bus_period_s, seen_topics, topic_draft
from tests.benches.mosquitto import LIMIT_S, Mosquitto, mosquitto
from tests.benches.refusals import refusing
from tests.benches.terminal_tables import rows_of

NOW = datetime(2026, 3, 2, 6, tzinfo=UTC)


def seen(payloads: Mapping[str, bytes], count: int = 1) -> list[SeenTopic]:
    heard = {topic: TopicMessage(payload, 100.0, False, count, 90.0) for topic, payload in payloads.items()}
    return seen_topics(heard, NOW)


def meaning(payload: bytes) -> tuple[object, object]:
    (topic,) = seen({"t": payload})
    numbers = tuple((number.place, number.value) for number in topic.numbers)
    return numbers, tuple((time.place, time.unit, time.age_s) for time in topic.times)


@pytest.mark.parametrize(
    ("payload", "numbers", "times"),
    [
        (b"21.5", ((None, 21.5),), ()),
        (b'"21.5"', ((None, 21.5),), ()),
        (b"1772431200", ((None, 1772431200.0),), ()),
        (b'{"t": 21.5, "at": "2026-03-02T05:59:00Z"}', (("t", 21.5),), (("at", None, 60.0),)),
        (b'{"t": [1, {"v": "2"}], "ok": true, "n": null}', (("t.0", 1.0), ("t.1.v", 2.0)), ()),
        (b'{"v": 3, "ts": 1772431140000}', (("v", 3.0),), (("ts", "ms", 60.0),)),
        (b'{"v": 3, "ts": 1772431140}', (("v", 3.0),), (("ts", "s", 60.0),)),
        (b'{"v": 3, "ts": 1772431140000000000}', (("v", 3.0),), (("ts", "ns", 60.0),)),
        (b'{"a.b": 1, "": 2}', (), ()),
        (b'{"v": NaN, "w": Infinity, "x": 1e999}', (), ()),
        (b'{"serial": "20260302", "when": "2026"}', (("serial", 20260302.0), ("when", 2026.0)), ()),
        (b'{"v": 3, "made": "2026-03-01", "id": "10:30"}', (("v", 3.0),), ()),
        (b"on", (), ()),
        (b"\xff\xfe\x00", (), ()),
        (b"[" * 100_000, (), ()),
        (b"", (), ()),
    ],
)  # fmt: skip
def test_numbers_and_times_of_payloads(payload: bytes, numbers: object, times: object) -> None:
    assert meaning(payload) == (numbers, times)


def test_what_a_payload_is_and_how_often_it_comes() -> None:
    kinds = {"a": b"1", "b": b"{}", "c": b"on", "d": b"\x00\x01", "e": b""}
    assert [topic.kind for topic in seen(kinds)] == ["number", "JSON", "text", "2 bytes", "empty"]
    assert seen({"a": b"1"}, count=6)[0].every_s == 2.0
    assert math.isnan(seen({"a": b"1"})[0].every_s)


def test_the_nearest_of_several_times_is_the_payloads_own() -> None:
    (topic,) = seen({"t": b'{"started": 1772000000, "ts": 1772431190, "next": 1772434800, "v": 3}'})
    assert [time.place for time in topic.times] == ["started", "ts", "next"]
    assert topic.time is not None
    assert topic.time.place == "ts"


def test_a_draft_reads_what_was_seen(tmp_path: Path) -> None:
    payloads = {"hall/a": b'{"t": 21.5, "ts": 1772431140000}', 'odd "\\\n topic': b"7", "state": b"on"}
    path = tmp_path / "draft.toml"
    path.write_text(topic_draft(seen(payloads, count=2), scale=0.5, unit="bar", place="mqtt://b", when="now"))
    profile = load_profile(str(path))
    assert isinstance(profile, MqttProfile)
    assert profile.max_age_s == 30.0, "three intervals of 10 s"
    first, second = profile.topics
    value, measured = first.read(payloads["hall/a"])
    assert (value, measured) == (10.75, NOW - timedelta(seconds=60))
    assert (second.topic, second.read(b"7")) == ('odd "\\\n topic', (3.5, None))
    with refusing(ValueError, "no_topic_number"):
        topic_draft(seen({"state": b"on"}), scale=1, unit="bar", place="b", when="now")


def inspect(*words: object) -> Result:
    return CliRunner().invoke(main, ["inspect", "topics", *map(str, words)], env={"COLUMNS": "200"})


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("http://nowhere",), "mqtts://HOST:PORT"),
        (("mqtt://192.0.2.1",), "can be read and changed by everyone in that network"),
        (("mqtt://127.0.0.1:1", "--draft", "a.txt"), "does not end in .toml"),
        (("mqtt://127.0.0.1:1",), "cannot open mqtt://127.0.0.1:1"),
    ],
)
def test_mistakes_are_named(words: tuple[str, ...], told: str) -> None:
    answer = inspect(*words)
    assert answer.exit_code in (2, 3)
    assert told in answer.output


def keep(broker: Mosquitto, topic: str, payload: str) -> None:
    """Let the broker keep a message, so that it comes at once to whoever subscribes."""
    command = ["mosquitto_pub", "-h", "127.0.0.1", "-p", str(broker.port), "-q", "1", "-r", "-t", topic, "-m", payload]
    subprocess.run(command, check=True, timeout=LIMIT_S)


@pytest.mark.peer
def test_topics_of_a_broker(tmp_path: Path) -> None:
    draft, at = tmp_path / "draft.toml", datetime.now(UTC) - timedelta(hours=1)
    with mosquitto(tmp_path) as broker:
        keep(broker, "hall/north", json.dumps({"t": 20.5, "at": at.isoformat()}))
        keep(broker, "hall/south", "18.25")
        keep(broker, "other", "1")
        answer = inspect(broker.url, "hall/#", "--seconds", LIMIT_S, "--most", 2, "--draft", draft, "--timeout", 60)
    assert answer.exit_code == 0, answer.output
    rows = rows_of(answer.output)
    assert rows[0][:7] == ["hall/north", "1, kept", "", "JSON", "t", "20.50", "at, ISO 8601"]
    assert 3600 <= int(rows[0][7].removesuffix(" s")) < 7200
    assert rows[1][:6] == ["hall/south", "1, kept", "", "number", "the payload", "18.25"]
    assert len(rows) == 2, "other was not asked for"
    assert f'kind = "mqtt"\nurl = "{broker.url}"\nperiod_s = 1' in answer.output
    assert load_profile(str(draft)).channels == 2
    config = tmp_path / "gateway.toml"
    shown = answer.output[answer.output.index("[[device]]") :].replace('"..."', '"broker"')
    config.write_text(f'[machine]\nname = "mill"\n{shown}')
    checked = CliRunner().invoke(main, ["check", str(config)])
    assert checked.exit_code == 0, checked.output


@pytest.mark.parametrize(("count", "period_s"), [(1, 1), (11, 1), (2, 10), (4, 4)])
def test_a_value_of_a_draft_may_be_as_old_as_three_periods_of_its_bus(count: int, period_s: int) -> None:
    """All messages came within 10 s; of a single one the interval is unknown."""
    found = seen({"a": b"1"}, count=count)
    assert bus_period_s(found) == period_s
    draft = topic_draft(found, scale=1, unit="bar", place="b", when="now")
    assert f"max_age_s = {3 * period_s}\n" in draft
