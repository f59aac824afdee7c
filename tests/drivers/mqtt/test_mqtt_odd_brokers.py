"""Brokers that refuse, or that send what no broker should: each ends in a value or in an error that says what is wrong.

They are written byte by byte from the standard (MQTT 3.1.1, OASIS 2014).
"""

import asyncio
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from time import monotonic

import pytest

from drivers.base import BadAnswer, ConnectError, Driver, DriverError, NoAnswer, Quality, Reading, Refused, SystemClock
from drivers.build import make_device
from drivers.mqtt import bus as mqtt_bus
from drivers.mqtt.bus import MqttBus
from drivers.section import LONGEST_ANSWER_S
from drivers.tap import Tap
from tests.benches.buses import make_bus
from tests.benches.driver_reads import values_or_reasons
from tests.benches.mqtt_packets import packet, received
from tests.benches.stream_server import Serve, stream_server

pytestmark = pytest.mark.simulated_time

LIMIT_S = 120.0
CONNECT, SUBSCRIBE, PING, GOODBYE = 1, 8, 12, 14
"""Kinds of packets (2.2.1)."""
ACCEPTED = b"\x20\x02\x00\x00"
PROFILE = """
protocol = "mqtt"
title = "two topics"
unit = "degC"
max_age_s = 60
[[topic]]
topic = "a"
[[topic]]
topic = "b"
"""


def message(topic: bytes, payload: bytes) -> bytes:
    return packet(0x30, len(topic).to_bytes(2, "big") + topic + payload)


def kept(topic: bytes, payload: bytes) -> bytes:
    """A message with RETAIN set (3.3.1.3)."""
    return packet(0x31, len(topic).to_bytes(2, "big") + topic + payload)


BOTH = message(b"a", b"1.5") + message(b"b", b"2.5")


def granting(codes: bytes) -> Callable[[bytes], bytes]:
    """Answers a subscription with these codes, one for each topic."""
    return lambda number: packet(0x90, number + codes)


BOTH_GRANTED = granting(b"\x01\x01")


def broker(accepts: bytes = ACCEPTED, grants: Callable[[bytes], bytes] = BOTH_GRANTED, then: bytes = BOTH) -> Serve:
    """A broker that answers a connection and a subscription like this, and then sends this many bytes."""

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(asyncio.IncompleteReadError, ConnectionError):
            while True:
                first, body = await received(reader)
                kind = first >> 4
                if kind == CONNECT:
                    writer.write(accepts)
                elif kind == SUBSCRIBE:
                    writer.write(grants(body[:2]) + then)
                elif kind == PING:
                    writer.write(b"\xd0\x00")
                elif kind == GOODBYE:
                    break
        writer.close()

    return serve


@asynccontextmanager
async def reading(
    serve: Serve, folder: Path, tap: Tap | None = None, timeout_s: float = 1.0
) -> AsyncIterator[tuple[MqttBus, Driver]]:
    (folder / "topics.toml").write_text(PROFILE)
    async with stream_server(serve) as port:
        bus = make_bus("hall", "mqtt", {"url": f"mqtt://127.0.0.1:{port}", "timeout_s": timeout_s}, tap)
        assert isinstance(bus, MqttBus)
        driver = make_device("d", bus, str(folder / "topics.toml"), 1, {"a": 0, "b": 1}, {}, SystemClock())
        try:
            yield bus, driver
        finally:
            await bus.close()


async def read(bus: MqttBus, driver: Driver) -> Sequence[Reading]:
    await bus.connect()
    await driver.connect()
    return await driver.read()


@pytest.mark.parametrize(
    ("accepts", "error", "says"),
    [
        (b"\x20\x02\x00\x01", ConnectError, "client_id"),
        (b"\x20\x02\x00\x02", ConnectError, "client_id"),
        (b"\x20\x02\x00\x03", Refused, "refuses a client without user .Server unavailable"),
        (b"\x20\x02\x00\x04", Refused, "refuses a client without user .Bad user name or password"),
        (b"\x20\x02\x00\x05", Refused, "refuses a client without user .Not authorized"),
        (b"\x20\x02\x00\x84", Refused, "refuses a client without user"),  # a code of MQTT 5
        (b"\x20\x01\x00", ConnectError, "Protocol error"),
        (b"HTTP/1.1 400 Bad Request\r\n\r\n", NoAnswer, "does not acknowledge the connection request within 1 s"),
        (b"", NoAnswer, "does not acknowledge the connection request within 1 s"),
    ],
)
async def test_a_broker_that_does_not_accept(
    accepts: bytes, error: type[DriverError], says: str, tmp_path: Path
) -> None:
    async with reading(broker(accepts), tmp_path) as (bus, driver):
        with pytest.raises(error, match=says):
            await read(bus, driver)


async def test_after_a_reconnect_what_was_kept_is_a_value_only_if_it_was_heard_before(tmp_path: Path) -> None:
    """The same payload is as old as its first arrival. Another one replaces the value, and nothing tells its age."""
    said = iter((BOTH, kept(b"a", b"1.5") + kept(b"b", b"9.5")))
    serve = broker(grants=lambda number: BOTH_GRANTED(number) + next(said), then=b"")
    async with reading(serve, tmp_path) as (bus, driver):
        assert values_or_reasons(await read(bus, driver)) == [1.5, 2.5]
        await bus.close()
        await bus.connect()
        async with asyncio.timeout(LIMIT_S):
            while (again := await driver.read())[1].quality is Quality.GOOD:
                await asyncio.sleep(0.01)
        unknown = "stale: the broker had kept this message of topic b, and it holds no time"
        assert values_or_reasons(again) == [1.5, f"{unknown}; the age is unknown until the next message"]


@pytest.mark.parametrize("codes", [b"\x01\x80", b"\x01\x87"])
async def test_a_topic_that_is_refused_is_its_own_channels_fault(codes: bytes, tmp_path: Path) -> None:
    """0x87 is MQTT 5's code for it; 0x80 that of 3.1.1."""
    async with reading(broker(grants=granting(codes), then=message(b"a", b"1.5")), tmp_path) as (bus, driver):
        expected = [1.5, "comm_fault: the broker refuses to send topic b (check the broker's rules)"]
        assert values_or_reasons(await read(bus, driver)) == expected


async def test_a_topic_that_is_refused_is_not_waited_for(tmp_path: Path) -> None:
    refusing = broker(grants=granting(b"\x01\x80"), then=message(b"a", b"1.5"))
    async with reading(refusing, tmp_path, timeout_s=LONGEST_ANSWER_S) as (bus, driver):
        async with asyncio.timeout(LONGEST_ANSWER_S / 2.0):
            assert values_or_reasons(await read(bus, driver))[0] == 1.5


async def test_a_topic_that_is_refused_is_asked_for_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mqtt_bus, "ASK_REFUSED_AGAIN_S", 0.0)
    codes = iter((b"\x01\x80", b"\x01"))
    async with reading(broker(grants=lambda number: packet(0x90, number + next(codes))), tmp_path) as (bus, driver):
        await bus.connect()
        assert bus.refuses("b")
        assert values_or_reasons(await driver.read()) == [1.5, 2.5]
        assert not bus.refuses("b")


async def test_a_topic_that_stays_refused_is_asked_for_once_a_minute(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked, now_s = list[bytes](), monotonic()
    monkeypatch.setattr(mqtt_bus, "monotonic", lambda: now_s)

    def refusing(number: bytes) -> bytes:
        asked.append(number)
        return packet(0x90, number + (b"\x01\x80" if len(asked) == 1 else b"\x80"))

    async with reading(broker(grants=refusing), tmp_path) as (bus, driver):
        await bus.connect()
        for minutes in range(3):
            for passed_s in (0.0, 30.0, 59.0):
                now_s += passed_s
                await driver.read()
                now_s -= passed_s
                assert len(asked) == 1 + minutes
            now_s += 60.0


async def test_a_topic_that_stays_silent_is_waited_for_once(tmp_path: Path) -> None:
    """Each wait would take the bus's timeout, and from its other devices' time."""
    async with reading(broker(then=message(b"a", b"1.5")), tmp_path) as (bus, driver):
        async with asyncio.timeout(LIMIT_S):
            await bus.connect()
            for _ in range(2 * int(LIMIT_S / bus.timeout_s)):
                silent = (await driver.read())[1]
        assert silent.detail == "no message of topic b has arrived yet"


async def test_messages_of_a_topic_are_counted_from_the_first(tmp_path: Path) -> None:
    said = iter((BOTH, message(b"a", b"1.6") + message(b"b", b"2.6")))
    serve = broker(grants=lambda number: BOTH_GRANTED(number) + next(said), then=b"")
    async with reading(serve, tmp_path) as (bus, driver):
        await read(bus, driver)
        first = await bus.latest("d", "ab")
        await bus.close()
        await bus.connect()
        async with asyncio.timeout(LIMIT_S):
            while (again := await bus.latest("d", "ab"))["b"].count < 2:
                await asyncio.sleep(0.01)
        assert [one.payload for one in again.values()] == [b"1.6", b"2.6"]
        for topic in "ab":
            assert again[topic].first_s == first[topic].arrived_s < again[topic].arrived_s


async def test_a_broker_that_refuses_all_topics_is_refused(tmp_path: Path) -> None:
    async with reading(broker(grants=granting(b"\x80\x80")), tmp_path) as (bus, driver):
        with pytest.raises(Refused, match=r"bus hall: mqtt://127.0.0.1:[0-9]+ refuses to send a, b"):
            await read(bus, driver)


@pytest.mark.parametrize("codes", [b"", b"\x01", b"\x01\x01\x01"])
async def test_an_acknowledgement_of_other_topics_is_a_bad_answer(codes: bytes, tmp_path: Path) -> None:
    async with reading(broker(grants=granting(codes)), tmp_path) as (bus, driver):
        with pytest.raises(BadAnswer, match=f"answers for {len(codes)} topics instead of 2"):
            await read(bus, driver)


@pytest.mark.parametrize(
    "then",
    [
        BOTH,
        message(b"\xff\xfe", b"3") + BOTH,  # no UTF-8
        message(b"c", b"3") + BOTH,
        packet(0x32, b"\x00\x01a\x00\x051.5") + packet(0x32, b"\x00\x01b\x00\x062.5"),  # QoS 1
        BOTH + b"\x30\xff\xff\xff\x7f\x00\x01a",  # 256 MB are announced, and do not come
    ],
)
async def test_what_is_readable_is_read(then: bytes, tmp_path: Path) -> None:
    async with reading(broker(then=then), tmp_path) as (bus, driver):
        assert values_or_reasons(await read(bus, driver)) == [1.5, 2.5]


async def test_what_nobody_asked_for_is_not_kept(tmp_path: Path) -> None:
    unasked = b"".join(message(b"x/%d" % number, b"3") for number in range(300))
    async with reading(broker(then=unasked + BOTH), tmp_path) as (bus, driver):
        assert values_or_reasons(await read(bus, driver)) == [1.5, 2.5]
        assert (await bus.heard(0.0, 2)).keys() == {"a", "b"}


async def test_only_a_limited_number_of_topics_of_a_wildcard_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mqtt_bus, "MOST_TOPICS", 20)
    many = b"".join(message(b"x/%d" % number, b"3") for number in range(300))
    async with reading(broker(grants=granting(b"\x01" * 3), then=many + BOTH), tmp_path) as (bus, driver):
        bus.want({"x/#"})
        assert values_or_reasons(await read(bus, driver)) == [1.5, 2.5], "the topics of channels are kept all the same"
        assert len(await bus.heard(0.0, 2)) == 22


@pytest.mark.parametrize(
    "then",
    [
        message(b"", b"3"),
        b"\x30\xff\xff\xff\xff\x7f",  # a length of five bytes
        b"\xf0\x00",  # a reserved kind
        b"\x30\x03\x00\x09a",  # a topic that is longer than its packet
        b"\xe0\x02\x8b\x00",  # MQTT 5 says why it ends the connection
        b"\x30\x00",
        b"\x90\x00",
    ],
)
async def test_what_no_broker_sends_ends_the_connection(then: bytes, tmp_path: Path) -> None:
    """The gateway connects again in the next period."""
    async with reading(broker(then=then), tmp_path) as (bus, driver):
        with pytest.raises(ConnectError):
            await read(bus, driver)


class FailsOnce:
    """A tap with a bug at the first message, which it gets in the library's thread."""

    failed = False

    def data(self, sent: bool, data: bytes) -> None:
        if not self.failed:
            self.failed = True
            raise RuntimeError("a bug")

    def frame(self, sent: bool, identifier: int, extended: bool, data: bytes) -> None:
        """Not used: there is no CAN."""

    def note(self, text: str) -> None:
        """Not used here."""


async def test_an_error_in_the_librarys_thread_is_a_lost_connection(tmp_path: Path) -> None:
    """Otherwise it would seem open, and nothing would ever be received again."""
    async with reading(broker(), tmp_path, tap := FailsOnce()) as (bus, driver):
        with suppress(ConnectError):  # if it comes while the reading waits
            await read(bus, driver)
        assert tap.failed
        assert values_or_reasons(await read(bus, driver)) == [1.5, 2.5]
