"""The outlet to InfluxDB at a real InfluxDB 1 and, for the interface of version 2, at VictoriaMetrics."""

import json
from pathlib import Path

import pytest

from gateway.listeners.outlets.feed import Feed
from gateway.listeners.outlets.influxdb import InfluxDbOutlet, InfluxDbSettings
from gateway.listeners.outlets.outlet import OutletError, Unacceptable
from tests.benches.feed_talk import heard, reading
from tests.benches.free_port import free_port
from tests.benches.line_servers import asked, influxdb1, victoria_metrics

pytestmark = pytest.mark.peer

AT, NANOSECONDS = "2026-01-05T06:00:00.25+00:00", 1767592800250000000


def settings(url: str, **changes: object) -> InfluxDbSettings:
    fields: dict[str, object] = {"name": "plant", "kind": "influxdb", "url": url, "timeout_s": 60.0}
    return InfluxDbSettings.model_validate(fields | changes)


def test_what_is_written_is_what_the_server_returns_with_the_samples_own_time(tmp_path: Path) -> None:
    awkward = 'front, "left" = 1\\2'
    with influxdb1(tmp_path) as server:
        outlet = InfluxDbOutlet(settings(server.url, database="talc"))
        outlet.open()
        outlet.send([reading(7, source_time=AT, quality="good", detail=""), heard("event", text=awkward, time=AT)])
        outlet.send([reading(7, source_time=AT, quality="good", detail="")])  # once more, as after a lost answer
        outlet.send([heard("decision", time=AT, corrected={"EX0C": 1.5}, predicted={"EX0C": None}),
                     heard("measurement"), heard("compensation"), heard("status"), heard("reasons")])  # fmt: skip
        (found,) = server.ask('SELECT * FROM "reading"')
        assert (found["time"], found["value"], found["quality"]) == (NANOSECONDS, 7.0, "good")
        assert (found["machine"], found["channel"], found["unit"]) == ("mill", "bed_front", "degC")
        assert [row["text"] for row in server.ask('SELECT "text" FROM "event"')] == [awkward]
        (decided,) = server.ask('SELECT * FROM "decision"')
        assert (decided["error"], decided["corrected"], decided.get("predicted")) == ("EX0C", 1.5, None)
        names = {row["name"] for row in server.ask("SHOW MEASUREMENTS")}
        assert names >= {"reading", "event", "control", "decision", "cycle", "compensation", "status"}
        outlet.close()


def test_tags_with_blanks_commas_equals_signs_and_quotes_come_back_as_they_are(tmp_path: Path) -> None:
    name = 'bed, front = "A" µ'
    with influxdb1(tmp_path) as server:
        outlet = InfluxDbOutlet(settings(server.url, database="talc"))
        outlet.send([heard("reading/x", channel=name, unit="degC", value=1.0, source_time=AT)])
        assert [row["channel"] for row in server.ask('SELECT * FROM "reading"')] == [name]
        outlet.close()


def test_a_line_of_another_type_is_refused_and_a_missing_database_is_waited_for(tmp_path: Path) -> None:
    with influxdb1(tmp_path) as server:
        asked(f"{server.url}/write?db=talc", b'reading,machine=mill value="text"')
        outlet = InfluxDbOutlet(settings(server.url, database="talc"))
        with pytest.raises(Unacceptable, match=r"400 .*field type conflict"):
            outlet.send([reading(1)])
        with pytest.raises(OutletError, match=r"404 .*database not found") as refused:
            InfluxDbOutlet(settings(server.url, database="other")).send([reading(1)])
        assert not isinstance(refused.value, Unacceptable)
        outlet.close()


def test_lines_for_a_server_that_is_not_there_wait() -> None:
    feed = Feed(chosen := settings(f"http://127.0.0.1:{free_port()}", database="talc"), InfluxDbOutlet(chosen))
    feed.put(reading(1), 0.0)
    assert feed.turn(0.0) == 1.0
    assert feed.turn(1.0) == 3.0
    assert ("Connection refused" in feed.problem, feed.waiting) == (True, 1)


def test_the_interface_of_version_2_is_understood_by_another_makers_server(tmp_path: Path) -> None:
    (tmp_path / "token").write_text("secret\n")
    with victoria_metrics(tmp_path) as url:
        outlet = InfluxDbOutlet(settings(url, bucket="talc", org="plant", token_file=str(tmp_path / "token")))
        outlet.send([reading(7, source_time=AT, quality="good")])
        outlet.close()
        asked(f"{url}/internal/force_flush")
        text = asked(f"{url}/api/v1/export?match[]=reading_value")
    stored = json.loads(text)
    assert (stored["values"], stored["timestamps"]) == ([7], [NANOSECONDS // 1_000_000])
    assert (stored["metric"]["channel"], stored["metric"]["machine"]) == ("bed_front", "mill")
