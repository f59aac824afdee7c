"""What the gateway waits for, heat, health: samples in, sentences out."""

import math
from datetime import timedelta

import pytest

from gateway.listeners.web import parts
from gateway.listeners.web.sentences import Amount, Atom, SaidRow, Sentence, ToldName, at, in_each
from gateway.model.codes import NoticeCode
from gateway.model.text import Text, json_of, texts
from gateway.model.wording import finding_text
from gateway.telemetry.messages import FrameMessage, PublishedReason, ReasonsMessage, SensorFinding
from tests.benches.heard import BEGAN, STEP, HeardMachine


def keys(rows: object) -> list[tuple[str, str, str]]:
    """Label, sentence and mark of each row."""
    assert isinstance(rows, list)
    return [(row.label, row.said.say, row.mark) for row in rows if isinstance(row, SaidRow)]


def test_what_blocks_a_measurement_and_what_the_operator_should_do_stand_there() -> None:
    heard = HeardMachine()
    heard.decision()
    heard.probing("blocked", "interval", "alarm 21612", "clean the sphere")
    found = {row.label: row for row in parts.waits(heard.seen)}
    assert found["label.waits_for"].said == Sentence("sentence.text", {"text": ToldName("alarm 21612")})
    assert found["label.operator"].said == Sentence("sentence.text", {"text": ToldName("clean the sphere")})
    assert found["label.probing"].mark == "notice"


def test_before_anything_is_heard_it_says_so() -> None:
    seen = HeardMachine().seen
    assert keys(list(parts.waits(seen))) == [
        ("label.probing", "probing.nothing_heard", ""),
        ("label.last", "last.none", ""),
    ]
    assert ("label.channels", "channels.none", "notice") in keys(list(parts.health(seen)))
    assert (list(parts.channels(seen)), list(parts.driven(seen)), list(parts.doubts(seen))) == ([], [], [])


def test_a_measurement_that_was_not_used_says_why() -> None:
    heard = HeardMachine()
    heard.measurement(1, None, reason="refused: alarm 21612")
    assert ("label.last", "last.failed", "bad") in keys(list(parts.waits(heard.seen)))
    heard.passes(STEP)
    heard.measurement(2)
    assert ("label.last", "last.used", "good") in keys(list(parts.waits(heard.seen)))


def test_channels_that_are_not_good_come_first_and_temperatures_before_others() -> None:
    heard = HeardMachine()
    heard.reading("growth", 250.0, unit="um")
    heard.reading("bed_rear")
    heard.reading("a_drive")
    heard.reading("z_nut", None, "sensor_fault")
    shown = list(parts.channels(heard.seen))
    assert [c.channel for c in shown] == ["z_nut", "a_drive", "bed_rear", "growth"]
    assert [c.value and c.value.u for c in shown] == [None, "°C", "°C", "µm"]
    assert [said.say for said in parts.doubts(heard.seen)] == ["doubt.failed"]
    assert ("label.channels", "channels.good", "bad") in keys(list(parts.health(heard.seen)))


@pytest.mark.parametrize(
    ("channel", "body"),
    [
        ("bed_front_left", "bed"),
        ("spindle_rear", "spindle"),
        ("a_cradle_left", "cradle"),
        ("c_table", "table"),
        ("y_nut", "slides"),
        ("coolant_in", "fluids"),
        ("cutting_fluid", "fluids"),
        ("Ambient-High", "ambient"),
        ("t17", ""),
    ],
)
def test_a_channels_name_tells_its_part_of_the_machine(channel: str, body: str) -> None:
    heard = HeardMachine()
    heard.reading(channel)
    (shown,) = parts.channels(heard.seen)
    assert shown.body == body


def test_every_bus_is_named_or_the_ones_that_missed_reads() -> None:
    heard = HeardMachine()
    heard.status(periods_missed={"tcp1": 0, "rtu1": 0})
    rows = {row.label: row for row in parts.health(heard.seen)}
    assert rows["label.buses"].said == Sentence("buses.good", {"names": ToldName("rtu1, tcp1")})
    assert "label.missed" not in rows
    heard.status(periods_missed={"tcp1": 3, "rtu1": 0})
    rows = {row.label: row for row in parts.health(heard.seen)}
    assert rows["label.missed"].said.values["text"] == ToldName("tcp1: 3")
    assert "label.buses" not in rows


def test_an_event_says_how_much_it_matters_and_the_newest_comes_first() -> None:
    heard = HeardMachine()
    for kind in ("state_update", "operator", "problem", "of_a_later_version"):
        heard.event(kind)
    assert [(e.kind, e.mark) for e in parts.events(heard.seen)] == [
        ("event.of_a_later_version", ""),
        ("event.problem", "bad"),
        ("event.operator", "notice"),
        ("event.state_update", ""),
    ]


def test_a_problem_and_its_end_are_one_line_and_what_lasts_comes_first() -> None:
    heard = HeardMachine()
    times = []
    for kind, subject in (
        ("problem", "bus a"), ("problem", "device b"), ("problem_ended", "bus a"), ("problem", "bus a"),
        ("problem_ended", "bus a"), ("operator", ""), ("problem", "bus a"), ("problem_ended", "bus c"),
    ):  # fmt: skip
        heard.passes(timedelta(minutes=1))
        times.append(heard.now.isoformat())
        heard.event(kind, subject=subject)
    a1, b, a1_end, a2, a2_end, operator, a3, c_end = times
    assert [(e.t, e.ended, e.mark) for e in parts.events(heard.seen)] == [
        (a3, None, "bad"),
        (b, None, "bad"),
        (c_end, None, "good"),
        (operator, None, "notice"),
        (a2, a2_end, "good"),
        (a1, a1_end, "good"),
    ]


def test_every_problem_that_lasts_says_what_to_do_and_none_that_has_ended() -> None:
    for code in NoticeCode:
        heard = HeardMachine()
        heard.event(subject="s", code=code)
        heard.event(subject="around", code=NoticeCode.INTERMITTENT, problem={"code": code, "values": {}})
        for shown in parts.events(heard.seen):
            assert (code in parts.TOLD_WITH_REMEDY) == (shown.do is None), code
            assert shown.do is None or shown.do.say in texts("en")
    heard.event("problem_ended", subject="s")
    assert [shown.do for shown in parts.events(heard.seen) if shown.ended] == [None]


def test_a_failed_bus_says_where_to_look() -> None:
    heard = HeardMachine()
    bus = Text(NoticeCode.BUS, name="rtu1")
    heard.event(subject=json_of({"": bus})[""])
    assert parts.events(heard.seen)[0].do == Sentence("do.look", {"first": in_each(bus)})


def test_channels_without_a_value_stand_beside_the_verdict() -> None:
    heard = HeardMachine()
    for number in range(5):
        heard.reading(f"bed_{number}", quality="good" if number == 0 else "comm_fault")
    said = parts.failed(heard.seen)
    assert said is not None
    assert said.values == {"n": Amount(4, d=0), "all": Amount(5, d=0)}
    heard.status(channels=26, channels_good=2)
    said = parts.failed(heard.seen)
    assert said is not None
    assert said.values["n"] == Amount(24, d=0)
    heard.status(channels=5, channels_good=5)  # of before they failed
    said = parts.failed(heard.seen)
    assert said is not None
    assert said.values["n"] == Amount(4, d=0)
    heard.seen.disappear(heard.now)
    assert parts.failed(heard.seen) is None, "nothing is known of a gateway that is gone"


def test_a_bus_or_a_device_that_failed_is_named_beside_the_verdict_until_it_answers() -> None:
    heard = HeardMachine()
    heard.reading("bed", None, "comm_fault")
    bus, device, channel = (Text(code, name="rtu1") for code in (NoticeCode.BUS, NoticeCode.DEVICE, NoticeCode.CHANNEL))

    def first() -> object:
        said = parts.failed(heard.seen)
        assert said is not None
        return said.values.get("first"), said.values.get("more")

    for subject in (channel, device, bus):
        heard.event(subject=json_of({"": subject})[""])
    assert first() == (in_each(bus), Amount(1, d=0))
    heard.event("problem_ended", subject=json_of({"": device})[""])
    assert first() == (in_each(bus), None)
    heard.boot = "boot-2"
    heard.reading("bed", None, "comm_fault")
    assert first() == (None, None), "the new run has not said so"


def test_a_device_that_is_only_slow_is_not_named_for_a_broken_sensor() -> None:
    heard = HeardMachine()
    heard.event(subject=json_of({"": Text(NoticeCode.DEVICE, name="node5")})[""])
    heard.reading("column")
    heard.reading("bed", None, "sensor_fault")
    said = parts.failed(heard.seen)
    assert said is not None
    assert "first" not in said.values
    heard.reading("column", None, "comm_fault")
    said = parts.failed(heard.seen)
    assert said is not None
    assert said.values["first"] == in_each(Text(NoticeCode.DEVICE, name="node5"))


def test_what_moves_an_error_adds_up_to_its_estimate() -> None:
    heard = HeardMachine()
    inputs: dict[str, float | None] = {"a": -5.94, "b": 3.33, "c": 2.26, "d": 0.31, "e": -0.24, "f": 0.19}
    reason = PublishedReason(4.83, True, 0.9, inputs, 1.96, 2.96, {}, 4.8, 0.5)
    heard.hear("reasons", ReasonsMessage(*heard.stamp(), 0, 12, "interval", {"EZ0A": reason}))
    (driven,) = parts.driven(heard.seen)
    shown = [amount.n or 0.0 for _, amount in driven.movers] + [driven.others.n or 0.0, driven.level.n or 0.0]
    assert sum(shown) == pytest.approx(4.8), "to the digit that is shown"
    assert driven.others.n == pytest.approx(1.96 + sum(n for n in inputs.values() if n) - sum(shown[:-2]), abs=0.2)


def test_abnormal_heat_says_where_how_much_and_since_when() -> None:
    heard = HeardMachine()
    heard.decision(0)
    heard.passes(STEP)
    heard.decision(1)
    motor = SensorFinding("offset", ("motor",), ("a_drive",), 4.5, 1.2, "motor or a_drive is off", since_k=-11)
    cold = SensorFinding("offset", ("bed",), (), -2.0, 1.2, "bed is off", since_k=1)
    swap = SensorFinding("swap", ("a", "b"), (), None, 1.2, "a and b may be exchanged", since_k=1)
    earlier = SensorFinding("offset", ("bed",), (), 2.0, 1.2, "bed is off by +2.0 K")
    heard.sensors({"motor": 1.0}, motor, cold, swap, earlier)
    values: dict[str, Atom] = {
        "names": ToldName("motor / a_drive"),
        "off": Amount(4.5, "K"),
        "at": at(BEGAN - 11 * STEP),
    }
    warmer, colder, exchanged, without = parts.doubts(heard.seen)
    assert warmer == Sentence("doubt.warmer", values)
    assert (colder.say, colder.values["off"]) == ("doubt.colder", Amount(2.0, "K"))
    both = finding_text("swap", ("a", "b"), math.nan)
    assert exchanged == Sentence("doubt.finding", {"text": in_each(both)})
    off = finding_text("offset", ("bed",), 2.0)
    assert without == Sentence("doubt.finding", {"text": in_each(off)}), "of an earlier program"
    for channel in ("a", "b", "c", "motor"):
        heard.reading(channel, 20.0)
    shown = {c.channel: (c.doubt, c.beside) for c in parts.channels(heard.seen)}
    assert shown == {"a": ("swap", ("b",)), "b": ("swap", ("a",)), "motor": ("offset", ("a_drive",)), "c": ("", ())}
    assert list(shown)[-1] == "c", "the doubtful ones come first"
    heard.sensors({"motor": 1.0}, motor, cold, loads=("spindle_speed",))
    warmer, colder = parts.doubts(heard.seen)
    assert warmer == Sentence("doubt.warmer_for_loads", values | {"loads": ToldName("spindle_speed")})
    assert colder.say == "doubt.colder_for_loads"


@pytest.mark.parametrize(
    ("left", "said", "days", "mark"),
    [
        (timedelta(days=30), "certificate.good", 30, "good"),
        (timedelta(days=29, hours=23), "certificate.renew", 29, "notice"),
        (timedelta(days=7), "certificate.renew", 7, "notice"),
        (timedelta(days=6, hours=23), "certificate.renew", 6, "bad"),
        (timedelta(hours=1), "certificate.renew", 0, "bad"),
        (timedelta(0), "certificate.ended", 0, "bad"),
        (timedelta(days=-3), "certificate.ended", -3, "bad"),
    ],
)
def test_a_certificate_says_how_long_it_is_valid_by_the_gateways_clock(
    left: timedelta, said: str, days: int, mark: str
) -> None:
    heard = HeardMachine()
    ends = (heard.now + left).isoformat()
    heard.status(certificates={"[telemetry.tls] certificate": ends, "[nc] certificate": "soon"})
    (row,) = [row for row in parts.health(heard.seen) if row.label == "label.certificate"]
    assert (row.said.say, row.mark) == (said, mark)
    assert row.said.values["field"] == ToldName("[telemetry.tls] certificate")
    assert row.said.values["n"] == Amount(days, d=0)


def test_inputs_that_are_no_channels_are_told_whether_or_not_they_move_an_error() -> None:
    heard = HeardMachine()
    heard.reading("spindle_rear", 31.2)
    heard.hear("frame", FrameMessage(*heard.stamp(), 0, {"spindle_rear": 31.2, "speed": 1500.0, "feed": None}, None))
    assert dict(parts.other_inputs(heard.seen)) == {"speed": 1500.0, "feed": None}
