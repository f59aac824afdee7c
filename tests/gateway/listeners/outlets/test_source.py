"""What comes from gateways over Zenoh and cannot be read is not passed on, and that is reported."""

import pytest

from gateway.config.telemetry import Telemetry
from gateway.listeners.outlets.outlet import OutletMessage
from gateway.listeners.outlets.source import GatewaySource
from gateway.telemetry.codec import encode
from tests.benches.feed_talk import heard
from tests.benches.free_port import free_port
from tests.benches.waits import wait_until
from tests.benches.zenoh_sessions import listening


def test_an_unreadable_message_is_reported_once_until_it_can_be_read_again(caplog: pytest.LogCaptureFixture) -> None:
    port, taken = free_port(), list[OutletMessage]()
    event, decision = heard("event", seq=1).message, heard("decision", seq=1).message
    assert event is not None
    assert decision is not None
    settings = Telemetry(listen=(), connect=(f"tcp/127.0.0.1:{port}",))
    with listening(port) as session, GatewaySource(settings, (), taken.append):

        def is_linked() -> bool:
            session.put("talc/mill/decision", encode(decision))
            return bool(taken)

        wait_until(is_linked)
        for payload in (b"{", b"[", b"{", encode(event)):
            session.put("talc/mill/event", payload)
        wait_until(lambda: [each.suffix for each in taken] == ["decision", "event"])
        session.put("talc/mill/event", b"{")
        wait_until(lambda: len(caplog.messages) == 3)
    began, ended, again = caplog.messages
    assert (began, ended) == (again, "mill: event can be read again")
    assert began.startswith("mill: not passed on: payload of event: ")
