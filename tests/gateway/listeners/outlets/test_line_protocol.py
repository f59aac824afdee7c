"""Line protocol: escaping, times of the samples, and what each kind of message becomes."""

from datetime import UTC, datetime

import pytest

from gateway.listeners.outlets.influxdb import InfluxDbSettings
from gateway.listeners.outlets.line_protocol import line, lines
from tests.benches.feed_talk import heard, reading

AT = datetime(2026, 1, 5, 6, 0, 0, 250000, tzinfo=UTC)


@pytest.mark.parametrize(
    ("tags", "fields", "expected"),
    [
        ({"machine": "mill 1", "a=b": "x,y"}, {"value": 20.0}, r"m,a\=b=x\,y,machine=mill\ 1 value=20.0"),
        ({}, {"text": 'say "no" to C:\\temp'}, r'm text="say \"no\" to C:\\temp"'),
        ({"t": "line\nbreak"}, {"text": "two\nlines"}, r'm,t=line\ break text="two lines"'),
        ({"t": "ends\\"}, {"on": True}, "m,t=ends/ on=true"),
        ({"empty": ""}, {"n": 3, "none": None, "x": 1e-07}, "m n=3i,x=1e-07"),
        ({"Öl": "µm"}, {"v": -0.0}, "m,Öl=µm v=-0.0"),
        ({}, {"k": 2**63, "below": -(2**63) - 1, "n": 2**63 - 1}, "m n=9223372036854775807i"),
    ],
)
def test_names_and_texts_are_escaped(tags: dict[str, str], fields: dict[str, object], expected: str) -> None:
    assert line("m", tags, fields, AT) == f"{expected} 1767592800250000000"  # type: ignore[arg-type]


def test_a_reading_has_the_time_of_its_value_and_one_without_a_value_that_of_its_message() -> None:
    times = {"source_time": "2026-01-05T06:00:00.25+00:00", "time": "2026-01-05T06:00:07+00:00"}
    (good,) = lines(reading(1, quality="good", detail="", **times))
    assert good == 'reading,channel=bed_front,machine=mill,unit=degC value=1.0,quality="good" 1767592800250000000'
    (stale,) = lines(heard("reading/bed_front", channel="bed_front", unit="degC", value=None, quality="stale",
                           detail="no new value", **times))  # fmt: skip
    assert stale.endswith('quality="stale",detail="no new value" 1767592807000000000')


def test_a_decision_has_a_line_for_each_error_without_what_is_unknown() -> None:
    first, *errors = lines(heard("decision", predicted={"EX0C": None}, corrected={"EX0C": 1.5}, sigma={}, limits={},
                                 trusted={"EX0C": False}, time="2026-01-05T06:00:00+00:00"))  # fmt: skip
    assert first.startswith("control,machine=mill phase=")
    assert errors == ["decision,error=EX0C,machine=mill corrected=1.5,trusted=false 1767592800000000000"]


def test_a_message_of_numbers_that_cannot_be_written_spoils_no_others() -> None:
    (control,) = lines(heard("decision", k=10**30, predicted={}, corrected={}, sigma={}, limits={}, trusted={},
                             time="2026-01-05T06:00:00+00:00"))  # fmt: skip
    assert " phase=" in control
    assert "k=" not in control


def test_a_message_whose_time_is_none_is_left_out() -> None:
    assert list(lines(heard("event", time="yesterday"))) == []


@pytest.mark.parametrize(
    ("fields", "problem"),
    [
        ({"url": "http://10.0.0.5", "database": "talc"}, "allow_unencrypted = true"),
        ({"url": "https://influx"}, "expected either bucket"),
        ({"url": "https://influx", "bucket": "b", "database": "d"}, "expected either bucket"),
        ({"url": "https://influx", "database": "d", "token_file": "t"}, "for a bucket of InfluxDB 2"),
        ({"url": "https://influx", "bucket": "b", "user": "u"}, "a bucket needs token_file"),
        ({"url": "http://localhost", "database": "d", "authority": "a"}, "no effect without TLS"),
        ({"url": "influx:8086", "database": "d"}, "expected https://HOST:PORT"),
    ],
)
def test_what_contradicts_itself_is_refused(fields: dict[str, object], problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        InfluxDbSettings.model_validate({"name": "plant", "kind": "influxdb"} | fields)
