"""An MQTT broker as a bus: it keeps the latest message of each topic that its devices want. It only reads."""

import asyncio
from collections.abc import Callable, Collection
from contextlib import suppress
from dataclasses import dataclass
from time import monotonic
from typing import TYPE_CHECKING

from drivers.base import ConnectError, DriverError, Refused, placed
from drivers.mqtt.packets import publish_packet
from drivers.mqtt.profile import MOST_BYTES
from drivers.mqtt.settings import MqttBusSettings
from drivers.tap import Tap
from drivers.text import Text

if TYPE_CHECKING:
    from drivers.mqtt.connection import MqttConnection

REFUSED_HINT = Text("mqtt_rules")
ASK_REFUSED_AGAIN_S = 60.0
MOST_TOPICS = 10_000
"""Most topics whose messages are kept: a wildcard, or a broker that sends what nobody asked for, must not fill the
memory."""


@dataclass(frozen=True, slots=True)
class TopicMessage:
    """The latest message of a topic."""

    payload: bytes
    arrived_s: float
    """Monotonic."""
    retained: bool
    """Whether the broker had kept it, so that it is older than its arrival."""
    count: int = 1
    """How many messages the topic has had."""
    first_s: float = 0.0
    """Arrival of the first of them, monotonic."""


class MqttBus:
    """One connection to a broker, which several devices share."""

    kind = MqttBusSettings.bus_kind
    units = MqttBusSettings.units

    def __init__(self, name: str, settings: MqttBusSettings, tap: Tap | None = None) -> None:
        """`tap`: receives each message as the packet in which it could have come. Raises SetupError."""
        # Importing paho costs memory: only for a bus that needs it.
        from drivers.mqtt import connection

        self.name, self.timeout_s = name, settings.timeout_s
        self._settings, self._tap = settings, tap
        self._make, self._matches = connection.MqttConnection, connection.is_subscribed
        self._topics: set[str] = set()
        self._latest: dict[str, TopicMessage] = {}
        self._connection: MqttConnection | None = None
        self._opened_s = self._asked_s = 0.0
        self._refused: Collection[str] = ()
        """Topics that the broker does not send."""
        self._arrived = asyncio.Event()

    def want(self, topics: Collection[str]) -> None:
        """Subscribe to these too, from the next connect on."""
        self._topics.update(topics)

    async def connect(self) -> None:
        """Connect and subscribe, unless connected. Raises ConnectError, NoAnswer, Refused, SetupError."""
        if self._connection is not None and self._connection.is_open:
            return
        await self.close()
        loop = asyncio.get_running_loop()
        with placed(self.name):
            connection = self._make(
                self._settings, self.timeout_s, on_message=self._hearing(loop), on_lost=lambda: self._lost(loop)
            )

        def opened() -> Collection[str]:
            connection.open()
            self._note("open")
            return connection.subscribe(sorted(self._topics)) if self._topics else ()

        opening = loop.run_in_executor(None, opened)
        try:
            with placed(self.name):
                refused = await asyncio.shield(opening)
                if refused and refused == self._topics:
                    what = Text("mqtt_refuses", url=self._settings.url, names=", ".join(sorted(refused)))
                    raise Refused(what, hint=REFUSED_HINT)
        except BaseException:  # cancelled: what is still being opened is closed afterwards
            opening.add_done_callback(lambda done: (done.exception(), loop.run_in_executor(None, connection.drop)))
            raise
        self._connection, self._refused = connection, refused
        self._opened_s = self._asked_s = monotonic()

    def _note(self, text: str) -> None:
        if self._tap is not None:
            self._tap.note(text)

    def _lost(self, loop: asyncio.AbstractEventLoop) -> None:
        """Runs in the library's thread, also after `close`."""
        if (connection := self._connection) is not None:
            self._note(f"lost {connection.lost}")
        self._tell(loop)

    async def close(self) -> None:
        connection, self._connection = self._connection, None
        if connection is not None:
            if connection.is_open:
                self._note("close")
            await asyncio.to_thread(connection.close if connection.is_open else connection.drop)

    async def latest(self, device: str, topics: Collection[str]) -> dict[str, TopicMessage]:
        """The latest messages of these topics. After connecting it waits `timeout_s` for those that have had none. A
        connection that was lost since it was used is opened again.

        Raises ConnectError when the connection is lost meanwhile, or what `connect` raises.
        """
        if self._connection is not None:
            await self.connect()
        await self._ask_refused_again()
        wanted = set(topics) - set(self._refused)
        await self._wait(lambda: self._latest.keys() >= wanted, self._opened_s + self.timeout_s, device)
        return {topic: self._latest[topic] for topic in topics if topic in self._latest}

    def refuses(self, topic: str) -> bool:
        """Whether the broker does not send this topic."""
        return topic in self._refused

    async def _ask_refused_again(self) -> None:
        """Now and then: its rules may have changed."""
        connection = self._connection
        if not self._refused or connection is None or monotonic() - self._asked_s < ASK_REFUSED_AGAIN_S:
            return
        self._asked_s = monotonic()
        with suppress(DriverError):  # what is wrong with the connection shows otherwise
            self._refused = await asyncio.to_thread(connection.subscribe, sorted(self._refused))

    async def heard(self, seconds: float, most: int) -> dict[str, TopicMessage]:
        """The latest message of each topic, after `seconds` or once `most` topics have one.

        A wildcard that is wanted brings every topic that matches it. Raises ConnectError when the connection is lost.
        """
        await self._wait(lambda: len(self._latest) >= most, monotonic() + seconds, "")
        return dict(self._latest)

    async def _wait(self, done: Callable[[], bool], until_s: float, device: str) -> None:
        """Until it is so, or until then. Raises ConnectError when the connection is lost."""
        connection = self._connection
        with suppress(TimeoutError):
            async with asyncio.timeout(max(0.0, until_s - monotonic())):
                while connection is not None and connection.is_open and not done():
                    self._arrived.clear()
                    await self._arrived.wait()
        if connection is None or not connection.is_open:
            why = Text("not_connected") if connection is None else connection.lost
            await self.close()
            raise ConnectError(Text("mqtt_failed", url=self._settings.url, why=why), bus=self.name, device=device)

    def _hearing(self, loop: asyncio.AbstractEventLoop) -> Callable[[str, bytes, bool], None]:
        def hear(topic: str, payload: bytes, retained: bool) -> None:
            """Runs in the library's thread; entries are replaced whole. What is too long to be read is cut."""
            if not self._is_wanted(topic):
                return
            payload = payload[: MOST_BYTES + 1]
            if self._tap is not None:
                self._tap.data(False, publish_packet(topic, payload, retained=retained))
            known = self._latest.get(topic)
            if retained and known is not None and known.payload == payload:
                return  # after a reconnect: when it arrived first is known better
            now_s = monotonic()
            count, first_s = (1, now_s) if known is None else (known.count + 1, known.first_s)
            self._latest[topic] = TopicMessage(payload, now_s, retained, count, first_s)
            self._tell(loop)

        return hear

    def _is_wanted(self, topic: str) -> bool:
        if topic in self._latest or topic in self._topics:
            return True
        return len(self._latest) < MOST_TOPICS and any(self._matches(wanted, topic) for wanted in tuple(self._topics))

    def _tell(self, loop: asyncio.AbstractEventLoop) -> None:
        with suppress(RuntimeError):  # the loop is closed
            loop.call_soon_threadsafe(self._arrived.set)
