"""Messages that cannot be read are reported when that begins and when it ends, and no program can fill the log."""

import logging

import pytest

from gateway.telemetry.codec import encode
from gateway.telemetry.messages import EventMessage
from gateway.telemetry.subscriber.site import SiteSeen
from gateway.telemetry.subscriber.unreadable import UnreadableMessages
from tests.benches.heard import BEGAN
from tests.benches.manual_clock import ManualClock

LOG = logging.getLogger("test.unreadable")
ERROR = ValueError("payload of event: no JSON")


def test_it_is_reported_once_for_each_machine_and_kind_and_when_it_ends(caplog: pytest.LogCaptureFixture) -> None:
    site = SiteSeen("talc", (), lambda: BEGAN, lambda: 0.0)
    event = encode(EventMessage("b", 1, BEGAN.isoformat(), "system", None, "problem", "x", None, None, None))
    for _ in range(100):
        site.take("talc/mill/event", b"{")
        site.take("talc/lathe/event", event)
        site.take("talc/mill/reading/bed", b"{")
    began = [message.split(": ")[:3] for message in caplog.messages]
    assert began == [["mill", "not shown", "payload of event"], ["mill", "not shown", "payload of reading/bed"]]
    for _ in range(2):
        site.take("talc/mill/event", event)
    assert caplog.messages[2:] == ["mill: event can be read again"]


def test_a_key_of_which_no_message_can_be_read_stays_reported_beside_good_ones(
    caplog: pytest.LogCaptureFixture,
) -> None:
    clock = ManualClock()
    unreadable = UnreadableMessages(LOG, "not shown", clock)
    for minute in range(30):
        clock.move_to(60.0 * minute)
        unreadable.invalid("mill", "reading/odd", ERROR)
        unreadable.valid("mill", "reading/bed")
    assert len(caplog.messages) == 1


def test_a_gateway_of_which_some_messages_can_be_read_is_intermittent(caplog: pytest.LogCaptureFixture) -> None:
    clock = ManualClock()
    unreadable = UnreadableMessages(LOG, "not shown", clock)
    for second in range(500):
        clock.move_to(float(second))
        unreadable.invalid("mill", "event", ERROR)
        unreadable.valid("mill", "event")
    assert len(caplog.messages) == 7
    assert "it is intermittent" in caplog.messages[-1]
    clock.move_to(600.0)
    unreadable.valid("mill", "event")
    assert caplog.messages[7:] == ["mill: event can be read again"]


def test_names_without_end_take_no_memory_and_fill_no_log(caplog: pytest.LogCaptureFixture) -> None:
    unreadable = UnreadableMessages(LOG, "not shown", ManualClock())
    for number in range(3000):
        unreadable.invalid(f"m{number}", "event", ERROR)
    unreadable.valid("m2000", "event")
    assert len(caplog.messages) == 1001
    assert caplog.messages[1000] == "more than 1000 keys had unreadable messages; those of others are not named"
    unreadable.valid("m0", "event")
    assert caplog.messages[1001:] == ["m0: event can be read again"]
