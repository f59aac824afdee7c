"""The session of a program that only reads: closed whatever happens, and opened at one place."""

import pytest
import zenoh

from gateway.model.codes import NoticeCode
from gateway.model.text import text_of
from gateway.telemetry.client import Machine, MachineError
from tests.benches.free_port import free_port


def refusing(_: object) -> zenoh.Session:
    raise zenoh.ZError("Unable to connect at /root/.cargo/zenoh-link-tcp/src/unicast.rs:321.")


def test_the_client_says_why_no_session_opens(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(zenoh, "open", refusing)
    with pytest.raises(MachineError) as raised, Machine("mill", connect=f"tcp/127.0.0.1:{free_port()}"):
        pass
    assert text_of(raised.value).says(NoticeCode.PLACE_CLOSED)


class Unsubscribed:
    """A session that opens, and then refuses every subscription and question."""

    def __init__(self) -> None:
        self.closed = 0

    def liveliness(self) -> None:
        raise zenoh.ZError("no")

    def close(self) -> None:
        self.closed += 1


def test_a_session_is_closed_if_what_follows_its_opening_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    opened = Unsubscribed()
    monkeypatch.setattr(zenoh, "open", lambda _: opened)
    with pytest.raises(zenoh.ZError, match="no"), Machine(connect="tcp/127.0.0.1:9"):
        pass
    assert opened.closed == 1
