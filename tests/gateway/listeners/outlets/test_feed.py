"""The queue of an outlet: order, bound, back-off, and one line in the log when it goes away and when it is back."""

import logging

import pytest

from gateway.listeners.outlets.feed import Feed
from gateway.listeners.outlets.influxdb import InfluxDbSettings
from gateway.listeners.outlets.mqtt import MqttOutletSettings
from gateway.listeners.outlets.outlet import OutletError, OutletMessage, Unacceptable
from tests.benches.feed_talk import FailingOutlet, heard, reading


def settings(**changes: object) -> MqttOutletSettings:
    return MqttOutletSettings.model_validate({"name": "plant", "kind": "mqtt", "url": "mqtt://127.0.0.1"} | changes)


def numbers(batch: list[OutletMessage]) -> list[int]:
    return [each.message.seq for each in batch if each.message is not None]


class UnclosableOutlet(FailingOutlet):
    """An outlet whose library raises when it is closed."""

    def close(self) -> None:
        raise ValueError("file descriptor cannot be a negative integer")


def test_messages_are_sent_in_their_order_in_batches() -> None:
    outlet = FailingOutlet()
    feed = Feed(settings(), outlet)
    for number in range(250):
        feed.put(reading(number), 0.0)
    for _ in range(3):
        feed.turn(0.0)
    assert [len(batch) for batch in outlet.sent] == [100, 100, 50]
    assert [n for batch in outlet.sent for n in numbers(batch)] == list(range(250))
    assert (feed.sent, feed.waiting, outlet.opened) == (250, 0, 1)


def test_an_absent_outlet_is_tried_after_1_2_4_up_to_60_s_and_is_logged_twice(caplog: pytest.LogCaptureFixture) -> None:
    outlet = FailingOutlet()
    outlet.away = OutletError("no broker")
    feed = Feed(settings(), outlet)
    now_s, pauses = 1000.0, []
    for _ in range(8):
        feed.put(reading(1), now_s)
        due_s = feed.turn(now_s)
        assert feed.turn(due_s - 0.5) == due_s, "not before its time"
        pauses.append(due_s - now_s)
        now_s = due_s
    assert pauses == [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 60.0, 60.0]
    outlet.away = None
    feed.turn(now_s)
    feed.put(reading(2), now_s)
    feed.turn(now_s)
    assert [record.message for record in caplog.records] == [
        "plant: no broker; messages wait, at most 20000",
        "plant: is back after 183 s; 0 messages were dropped meanwhile",
    ]
    assert feed.sent == 9


def test_the_oldest_are_dropped_and_counted_when_too_many_wait(caplog: pytest.LogCaptureFixture) -> None:
    outlet = FailingOutlet()
    outlet.away = OutletError("no broker")
    feed = Feed(settings(most_waiting=100), outlet)
    feed.turn(0.0)
    for number in range(130):
        feed.put(reading(number), 0.5)
    assert (feed.waiting, feed.dropped) == (100, 30)
    outlet.away = None
    feed.turn(1.0)
    assert numbers(outlet.sent[0]) == list(range(30, 130))
    assert caplog.records[-1].message == "plant: is back after 1 s; 30 messages were dropped meanwhile"


def test_what_was_not_acknowledged_is_sent_again_in_its_place() -> None:
    outlet = FailingOutlet()
    feed = Feed(settings(), outlet)
    for number in (1, 2, 3):
        feed.put(reading(number), 0.0)
    outlet.failing = OutletError("lost")
    assert feed.turn(0.0) == 1.0
    assert not outlet.is_open
    feed.put(reading(4), 0.5)
    outlet.failing = None
    feed.turn(1.0)
    assert [numbers(batch) for batch in outlet.sent] == [[1, 2, 3, 4]]


def test_what_the_other_side_will_never_take_does_not_stop_the_rest(caplog: pytest.LogCaptureFixture) -> None:
    outlet = FailingOutlet()
    feed = Feed(settings(), outlet)
    for number in (1, 2):
        feed.put(reading(number), 0.0)
        outlet.failing = Unacceptable("unparsable")
        feed.turn(0.0)
    outlet.failing = None
    for number, now_s in ((3, 0.0), (4, 600.0)):
        feed.put(reading(number), now_s)
        feed.turn(now_s)
    assert [numbers(batch) for batch in outlet.sent] == [[3], [4]]
    assert (feed.sent, feed.unacceptable) == (2, 2)
    assert [r.message for r in caplog.records] == [
        "plant: 1 messages are not accepted and were dropped: unparsable",
        "plant: messages are accepted again; 2 were dropped",
    ]


def test_a_refusal_is_reported_again_after_it_ended_and_when_its_reason_changes(
    caplog: pytest.LogCaptureFixture,
) -> None:
    outlet, refused = FailingOutlet(), Unacceptable("of another type")
    feed = Feed(settings(), outlet)
    for number, failing in enumerate((refused, refused, None, refused, Unacceptable("too large"), refused, None)):
        outlet.failing = failing
        feed.put(reading(number), 1000.0 * number)
        feed.turn(1000.0 * number)
    assert caplog.messages == [
        "plant: 1 messages are not accepted and were dropped: of another type",
        "plant: messages are accepted again; 2 were dropped",
        "plant: 1 messages are not accepted and were dropped: of another type",
        "plant: 1 messages are not accepted and were dropped: too large",
        "plant: messages are accepted again; 3 were dropped",
    ]


def test_a_turn_without_messages_ends_no_refusal(caplog: pytest.LogCaptureFixture) -> None:
    outlet = FailingOutlet()
    feed = Feed(settings(), outlet)
    outlet.failing = Unacceptable("of another type")
    for now_s in (0.0, 100.0):
        feed.put(reading(1), now_s)
        feed.turn(now_s)
        feed.turn(now_s + 90.0)
    assert len(caplog.messages) == 1


def test_a_refusal_between_accepted_messages_lasts_until_ten_minutes_without_one(
    caplog: pytest.LogCaptureFixture,
) -> None:
    outlet, refused = FailingOutlet(), Unacceptable("of another type")
    feed = Feed(settings(), outlet)
    for number in range(100):
        outlet.failing = None if number % 10 else refused
        feed.put(reading(number), 30.0 * number)
        feed.turn(30.0 * number)
    assert caplog.messages == ["plant: 1 messages are not accepted and were dropped: of another type"]
    for now_s in (3290.0, 3310.0):
        feed.put(reading(1), now_s)
        feed.turn(now_s)
        assert len(caplog.messages) == (1 if now_s < 3300.0 else 2), "the last one was refused at 2700 s"
    assert caplog.messages[1:] == ["plant: messages are accepted again; 10 were dropped"]


def test_an_intermittent_outlet_is_reported_so_and_then_not_until_it_was_steady_for_ten_minutes(
    caplog: pytest.LogCaptureFixture,
) -> None:
    failing = OutletError("reset")
    outlet = FailingOutlet()
    feed = Feed(settings(most_waiting=100), outlet)
    for number in range(400):
        outlet.failing = failing if number % 2 else None
        feed.put(reading(number), 10.0 * number)
        feed.turn(10.0 * number)
    assert len(caplog.messages) == 7, "three beginnings and ends, and the beginning of what is intermittent"
    assert caplog.messages[-1].endswith("; it is intermittent: reported again when it has been steady for 600 s")
    outlet.failing = None
    for second in range(4000, 4700, 10):
        feed.put(reading(second), float(second))
        feed.turn(float(second))
    assert caplog.messages[7:] == ["plant: is back after 10 s; 0 messages were dropped meanwhile"]


def test_what_goes_wrong_while_it_is_away_is_not_another_line(caplog: pytest.LogCaptureFixture) -> None:
    outlet = FailingOutlet()
    feed, now_s = Feed(settings(), outlet), 0.0
    for port in range(50000, 50020):
        outlet.away = OutletError(f"refused from port {port}")
        now_s = feed.turn(now_s)
    assert len(caplog.messages) == 1
    assert "refused from port 50000" in caplog.messages[0]
    assert feed.problem == "refused from port 50019"


def test_an_error_that_no_outlet_should_raise_ends_no_feed_and_loses_nothing(caplog: pytest.LogCaptureFixture) -> None:
    outlet = FailingOutlet()
    feed = Feed(settings(), outlet)
    feed.put(reading(1), 0.0)
    outlet.failing = RecursionError("too deep")
    assert feed.turn(0.0) == 1.0
    assert feed.turn(1.0) == 3.0
    assert (feed.problem, feed.waiting) == ("unexpected RecursionError: too deep", 1)
    outlet.failing = None
    feed.turn(3.0)
    assert ([numbers(batch) for batch in outlet.sent], feed.problem) == ([[1]], "")
    assert [(record.message, record.exc_info is not None) for record in caplog.records] == [
        ("plant: unexpected RecursionError: too deep; please report this; messages wait, at most 20000", True),
        ("plant: is back after 3 s; 0 messages were dropped meanwhile", False),
    ]


def test_a_library_that_wants_to_end_the_program_ends_no_feed(caplog: pytest.LogCaptureFixture) -> None:
    outlet = FailingOutlet()
    feed = Feed(settings(), outlet)
    feed.put(reading(1), 0.0)
    outlet.failing = SystemExit(1)
    assert feed.turn(0.0) == 1.0
    assert "unexpected SystemExit: 1" in feed.problem
    assert [record.exc_info is not None for record in caplog.records] == [True]
    outlet.failing = None
    feed.turn(1.0)
    assert [numbers(batch) for batch in outlet.sent] == [[1]]


def test_a_library_that_fails_at_closing_ends_no_feed_and_loses_nothing() -> None:
    outlet = UnclosableOutlet()
    feed = Feed(settings(), outlet)
    feed.put(reading(1), 0.0)
    outlet.failing = OutletError("lost")
    assert feed.turn(0.0) == 1.0
    outlet.failing = None
    feed.turn(1.0)
    assert ([numbers(batch) for batch in outlet.sent], outlet.opened) == ([[1]], 2)
    feed.stop()
    feed.run()


def test_by_default_lines_wait_five_seconds_for_others_or_until_there_are_a_thousand() -> None:
    outlet = FailingOutlet()
    given = {"name": "plant", "kind": "influxdb", "url": "http://127.0.0.1", "database": "talc"}
    feed, one = Feed(InfluxDbSettings.model_validate(given), outlet), reading(1)
    feed.turn(0.0)
    feed.put(one, 10.0)
    feed.turn(14.9)
    assert outlet.sent == []
    feed.turn(15.0)
    for _ in range(999):
        feed.put(one, 20.0)
    feed.turn(20.0)
    assert [len(batch) for batch in outlet.sent] == [1]
    feed.put(one, 20.0)
    feed.turn(20.0)
    assert [len(batch) for batch in outlet.sent] == [1, 1000]


def test_only_the_wanted_kinds_and_readings_not_too_often_are_passed_on() -> None:
    outlet = FailingOutlet()
    feed = Feed(settings(kinds=["reading", "event"], reading_every_s=10.0), outlet)
    feed.put(heard("decision"), 0.0)
    for second in range(25):
        quality = "good" if second != 12 else "stale"
        feed.put(reading(second, time=f"2026-01-05T06:00:{second:02}+00:00", quality=quality), 0.0)
    feed.put(heard("event", seq=99), 0.0)
    feed.turn(0.0)
    assert numbers(outlet.sent[0]) == [0, 10, 12, 13, 23, 99]


def test_a_clock_that_is_set_back_withholds_no_reading() -> None:
    outlet = FailingOutlet()
    feed = Feed(settings(reading_every_s=10.0), outlet)
    for number, time in enumerate(("07:00:00", "06:00:00", "06:00:05", "06:00:10")):
        feed.put(reading(number, time=f"2026-01-05T{time}+00:00"), 0.0)
    feed.turn(0.0)
    assert numbers(outlet.sent[0]) == [0, 1, 3]


def test_an_outlet_that_hangs_delays_nobody(caplog: pytest.LogCaptureFixture) -> None:
    """`put` is what the subscriber's thread calls: it returns while the outlet's thread is inside `send`."""
    import threading

    inside, go_on = threading.Event(), threading.Event()

    class Hanging(FailingOutlet):
        def send(self, batch: object) -> None:
            inside.set()
            assert go_on.wait(120.0)

    feed = Feed(settings(most_waiting=100), Hanging())
    feed.put(reading(0), 0.0)
    thread = threading.Thread(target=feed.run)
    thread.start()
    assert inside.wait(120.0)
    for number in range(150):
        feed.put(reading(number), 0.0)
    assert (feed.waiting, feed.dropped) == (100, 50)
    caplog.set_level(logging.CRITICAL)
    feed.stop()
    go_on.set()
    thread.join(120.0)
    assert not thread.is_alive()
