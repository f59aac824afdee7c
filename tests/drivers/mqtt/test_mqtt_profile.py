"""Values and times in MQTT payloads, and payloads with mistakes."""

from collections.abc import Iterator
from datetime import UTC, datetime
from time import tzset

import pytest

from drivers.base import Quality
from drivers.faults import Fault
from drivers.mqtt.profile import MqttTopic

NOON = datetime(2026, 1, 5, 12, tzinfo=UTC)


def topic(**fields: object) -> MqttTopic:
    return MqttTopic.model_validate({"topic": "plant/t"} | fields)


@pytest.mark.parametrize(
    ("fields", "payload", "value"),
    [
        ({}, b"21.5", 21.5),
        ({}, b" -3 \n", -3.0),
        ({}, b'"21.5"', 21.5),
        ({}, b'" -.5e1 "', -5.0),
        ({}, b"+21.5", 21.5),
        ({}, b"00317.5", 317.5),
        ({}, b".5", 0.5),
        ({}, b"21.", 21.0),
        ({}, b"21.5\0", 21.5),
        ({"number": "t"}, b'{"t": 21.5}\0\0', 21.5),
        ({"number": "box.1.t"}, b'{"box.1": {"t": 3}}', 3.0),
        ({"number": "a.b"}, b'{"a.b": 4, "a": {"c": 5}}', 4.0),
        ({"number": "t"}, b'{"t": 4, "t": 4, "a": 1, "a": 2}', 4.0),
        ({"scale": 0.1, "offset": -273.15}, b"2981.5", 25.0),
        ({"number": "temperature"}, b'{"temperature": 21.5, "humidity": 40}', 21.5),
        ({"number": "sensors.1.t"}, b'{"sensors": [{"t": 1}, {"t": 2}]}', 2.0),
    ],
)
def test_a_number_is_found(fields: dict[str, object], payload: bytes, value: float) -> None:
    found, measured = topic(**fields).read(payload)
    assert found == pytest.approx(value)
    assert measured is None


@pytest.mark.parametrize(
    ("fields", "payload", "quality", "detail"),
    [
        ({}, b"", Quality.SENSOR_FAULT, "neither a number nor JSON: ''"),
        ({}, b"on", Quality.SENSOR_FAULT, "neither a number nor JSON: 'on'"),
        ({}, b"\xff\x00", Quality.SENSOR_FAULT, "neither a number nor JSON"),
        ({}, b"true", Quality.SENSOR_FAULT, "holds no number: 'true'"),
        ({}, b"null", Quality.SENSOR_FAULT, "holds no number"),
        ({}, b"NaN", Quality.SENSOR_FAULT, "holds no number"),
        ({}, b"1e999", Quality.SENSOR_FAULT, "holds no number"),
        ({}, b"9" * 400, Quality.SENSOR_FAULT, "holds no number"),
        ({}, b"9" * 70_000, Quality.SENSOR_FAULT, "the payload has more than 65536 bytes"),
        ({}, b"[" * 60_000, Quality.SENSOR_FAULT, "neither a number nor JSON"),
        ({}, b'"1_000"', Quality.SENSOR_FAULT, "holds no number"),
        ({}, b'"21,5"', Quality.SENSOR_FAULT, "holds no number"),
        ({}, b'"0x15"', Quality.SENSOR_FAULT, "holds no number"),
        ({}, b'"inf"', Quality.SENSOR_FAULT, "holds no number"),
        ({}, '"２１"'.encode(), Quality.SENSOR_FAULT, "holds no number"),
        ({}, b"21,5", Quality.SENSOR_FAULT, "neither a number nor JSON"),
        ({}, b"21.5 degC", Quality.SENSOR_FAULT, "neither a number nor JSON"),
        ({}, b'{"t": 1}', Quality.SENSOR_FAULT, "holds no number"),
        ({"number": "t"}, b"21.5", Quality.SENSOR_FAULT, "holds no number at t: '21.5'"),
        ({"number": "a.b"}, b'{"a.b": 4, "a": {"b": 5}}', Quality.SENSOR_FAULT, "holds no number at a.b"),
        ({"number": "t"}, b'{"t": 1, "t": 2, "t": 2}', Quality.SENSOR_FAULT, "holds no number at t"),
        ({"number": "t.3"}, b'{"t": [1]}', Quality.SENSOR_FAULT, "holds no number at t.3"),
        ({"number": "t", "high": 100}, b'{"t": 850}', Quality.OUT_OF_RANGE, "850 is beyond the profile's limits"),
        ({"number": "t", "time": "at"}, b'{"t": 1}', Quality.STALE, "holds no time at at"),
        ({"number": "t", "time": "at"}, b'{"t": 1, "at": "noon"}', Quality.STALE, "holds no time at at"),
        ({"number": "t", "time": "at"}, b'{"t": 1, "at": 1e300}', Quality.STALE, "holds no time at at"),
        ({"number": "t", "time": "at"}, b'{"t": 1, "at": true}', Quality.STALE, "holds no time at at"),
    ],
)
def test_a_payload_without_a_value_is_a_fault_that_says_why(
    fields: dict[str, object], payload: bytes, quality: Quality, detail: str
) -> None:
    found, _ = topic(**fields).read(payload)
    assert isinstance(found, Fault)
    assert (found.quality, detail in found.detail) == (quality, True), found.detail


@pytest.fixture
def elsewhere(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """This computer's own time is five hours behind UTC."""
    with monkeypatch.context() as patch:
        patch.setenv("TZ", "EST5")
        tzset()
        yield
    tzset()


@pytest.mark.usefixtures("elsewhere")
@pytest.mark.parametrize(
    ("unit", "time"),
    [
        ("s", '"2026-01-05T12:00:00Z"'),
        ("s", '"2026-01-05T13:00:00+01:00"'),
        ("s", '"2026-01-05T12:00:00"'),
        ("s", "1767614400"),
        ("ms", "1767614400000"),
        ("ms", '"1767614400000"'),
        ("s", '"1767614400.0"'),
        ("us", "1767614400000000"),
        ("ns", "1767614400000000000"),
    ],
)
def test_the_time_of_the_payload(unit: str, time: str) -> None:
    found, measured = topic(number="t", time="at", time_unit=unit).read(b'{"t": 1, "at": %s}' % time.encode())
    assert (found, measured) == (1.0, NOON)
