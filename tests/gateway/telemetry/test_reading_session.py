"""The session of a program that only reads: closed whatever happens, and opened at one place."""

from pathlib import Path

import pytest
import zenoh

from gateway.config.telemetry import Telemetry
from gateway.listeners.collect.network import SiteNetwork
from gateway.telemetry.client import Machine, MachineError
from gateway.telemetry.session import TelemetryError
from gateway.telemetry.subscriber.hearing import Hearing

GATEWAY = Path(__file__).parents[3] / "gateway"
NOWHERE = Telemetry(listen=(), connect=("tcp/127.0.0.1:9",))


def refusing(_: object) -> zenoh.Session:
    raise zenoh.ZError("Unable to connect at /root/.cargo/zenoh-link-tcp/src/unicast.rs:321.")


@pytest.mark.parametrize(
    ("reader", "kind", "says"),
    [
        (SiteNetwork(NOWHERE), TelemetryError, "no Zenoh session: Unable to connect"),
        (
            Hearing(NOWHERE, lambda *_: None, lambda *_: True),
            TelemetryError,
            "no Zenoh session to tcp/127.0.0.1:9: Unable to connect",
        ),
        (
            Machine("mill", connect="tcp/127.0.0.1:9"),
            MachineError,
            "no answer at tcp/127.0.0.1:9. Is the gateway running? Unable to connect",
        ),
    ],
    ids=["collect", "heard", "client"],
)
def test_each_reader_says_in_its_own_words_why_no_session_opens(
    reader: SiteNetwork | Hearing | Machine, kind: type[OSError], says: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(zenoh, "open", refusing)
    with pytest.raises(kind) as raised, reader:
        pass
    assert str(raised.value) == says


class Unsubscribed:
    """A session that opens, and then refuses every subscription and question."""

    def __init__(self) -> None:
        self.closed = 0

    def declare_subscriber(self, *_: object) -> None:
        raise zenoh.ZError("no")

    def liveliness(self) -> None:
        raise zenoh.ZError("no")

    def close(self) -> None:
        self.closed += 1


@pytest.mark.parametrize(
    "reader",
    [Hearing(NOWHERE, lambda *_: None, lambda *_: True), Machine(connect="tcp/127.0.0.1:9")],
    ids=["heard", "client"],
)
def test_a_session_is_closed_if_what_follows_its_opening_fails(
    reader: Hearing | Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = Unsubscribed()
    monkeypatch.setattr(zenoh, "open", lambda _: opened)
    with pytest.raises(zenoh.ZError, match="no"), reader:
        pass
    assert opened.closed == 1


def test_sessions_are_opened_in_the_telemetry_s_room_alone() -> None:
    found = {path.relative_to(GATEWAY) for path in GATEWAY.rglob("*.py") if "zenoh.open" in path.read_text("utf-8")}
    assert {path.parts[0] for path in found} == {"telemetry"}
