"""Outlet to an MQTT broker: the messages as they are published over Zenoh, under topics with the same names."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from drivers.base import DriverError
from drivers.mqtt.settings import MqttServer
from drivers.section import matching
from gateway.listeners.outlets.home_assistant import discoveries
from gateway.listeners.outlets.outlet import OutletError, OutletMessage, OutletSettings
from gateway.model.codes import NoticeCode
from gateway.model.text import text_of
from gateway.telemetry import keys

if TYPE_CHECKING:
    from drivers.mqtt.connection import MqttConnection

_LEVELS = matching(r"[^+#/\x00]+(/[^+#/\x00]+)*", NoticeCode.MQTT_LEVELS)
Topic = Annotated[str, Field(max_length=1000), _LEVELS]
"""The first levels of topics."""

ONLINE = b"online"
OFFLINE = b"offline"
OUTLET_LEVEL = "_outlet"
"""Level beside the machines', whose names begin with a letter."""


class MqttOutletSettings(OutletSettings, MqttServer):
    """An MQTT broker."""

    kind: Literal["mqtt"]
    """`mqtt`."""
    topic: Topic = "talc"
    """First levels of every topic; the machine's name and the key follow."""
    home_assistant: Topic | None = None
    """Discovery prefix of Home Assistant, usually `homeassistant`: announce channels, errors and the phase there. None:
    announce nothing."""

    def outlet(self) -> "MqttOutlet":
        return MqttOutlet(self)


class MqttOutlet:
    """Publishes to one broker. Every topic but `event` is retained.

    After each connect the last message of every retained topic is published again, as the broker may have forgotten it.
    """

    def __init__(self, settings: MqttOutletSettings) -> None:
        """Raises SetupError for files that cannot be used."""
        # Importing paho costs memory: only where it is wanted.
        from drivers.mqtt.connection import MqttConnection, Publication

        self._settings = settings
        self._make, self._publication = MqttConnection, Publication
        self.state_topic = f"{settings.topic}/{OUTLET_LEVEL}/{settings.name}"
        """Holds `online` or, as the last will, `offline`."""
        self._retained: dict[str, bytes] = {}
        self._announced: set[str] = set()
        self._connection: MqttConnection | None = None
        self._made()

    def _made(self) -> "MqttConnection":
        will = self._publication(self.state_topic, OFFLINE, retained=True)
        return self._make(self._settings, self._settings.timeout_s, will=will)

    def open(self) -> None:
        """Connect, and say that this outlet is there. Raises OutletError."""
        try:
            self._connection = self._made()
            self._connection.open()
            self._publish([(self.state_topic, ONLINE, True)])
            known = list(self._retained.items())
            for begin in range(0, len(known), self._settings.batch):
                some = known[begin : begin + self._settings.batch]
                self._publish([(topic, payload, True) for topic, payload in some])
        except DriverError as error:
            raise OutletError(text_of(error)) from error

    def send(self, batch: Sequence[OutletMessage]) -> None:
        """Publish these; the broker has acknowledged each. Raises OutletError."""
        wanted = [each for heard in batch for each in self._of(heard)]
        try:
            self._publish(wanted)
        except DriverError as error:
            raise OutletError(text_of(error)) from error
        for topic, payload, retained in wanted:
            if retained:
                self._retained[topic] = payload

    def close(self) -> None:
        """Say goodbye if the connection is there."""
        connection, self._connection = self._connection, None
        if connection is None:
            return
        if connection.is_open:
            try:
                connection.publish([self._publication(self.state_topic, OFFLINE, retained=True)])
            except DriverError:
                connection.drop()  # the broker publishes the will
            else:
                connection.close()
        else:
            connection.drop()

    def _publish(self, wanted: Sequence[tuple[str, bytes, bool]]) -> None:
        if self._connection is not None:
            self._connection.publish([self._publication(*each) for each in wanted])

    def _of(self, heard: OutletMessage) -> Iterator[tuple[str, bytes, bool]]:
        """Topic, payload, and whether it is retained."""
        root = f"{self._settings.topic}/{heard.machine}"
        if heard.message is None:
            yield f"{root}/{keys.ALIVE}", ONLINE if heard.alive else OFFLINE, True
            return
        if self._settings.home_assistant is not None:
            states = (f"{root}/{keys.ALIVE}", self.state_topic)
            for topic, payload in discoveries(heard, self._settings.home_assistant, root, states):
                if topic not in self._announced:
                    self._announced.add(topic)
                    yield topic, payload, True
        yield f"{root}/{heard.suffix}", heard.payload, keys.kind_of(heard.suffix) != keys.EVENT
