"""Topics of an MQTT broker as the channels of a device."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from time import monotonic

from drivers.base import Clock, Quality, Reading
from drivers.faults import Fault
from drivers.mqtt.bus import REFUSED_HINT, MqttBus, TopicMessage
from drivers.mqtt.profile import MqttProfile, MqttTopic
from drivers.readings import ReadingMaker
from drivers.text import Text


class MqttDevice:
    """Some topics; `channels` maps names to the profile's topics, counted from 0."""

    def __init__(
        self, device: str, bus: MqttBus, profile: MqttProfile, channels: Mapping[str, int], clock: Clock
    ) -> None:
        self.device, self.channels = device, tuple(channels)
        self._bus, self._clock, self._max_age_s = bus, clock, profile.max_age_s
        self._topics = {name: profile.topics[number] for name, number in channels.items()}
        self._names = {topic.topic for topic in self._topics.values()}
        self._newest: dict[str, _Found] = {}
        """Of each channel: a message may overtake another."""
        self._maker = ReadingMaker({name: topic.unit or profile.unit for name, topic in self._topics.items()}, clock)
        bus.want(self._names)

    async def connect(self) -> None:
        """Nothing to ask: a topic may be silent for long."""

    async def read(self, *, again: bool = False) -> Sequence[Reading]:  # noqa: ARG002
        """One reading per channel, as old as its payload says. Raises ConnectError."""
        latest = await self._bus.latest(self.device, self._names)
        return self._maker.make_aged(
            {name: self._judged(name, topic, latest.get(topic.topic)) for name, topic in self._topics.items()}
        )

    async def close(self) -> None:
        """Nothing to close: the connection is the bus's."""

    def _judged(self, name: str, topic: MqttTopic, message: TopicMessage | None) -> tuple[float | Fault, float]:
        """The value and its age, s."""
        if self._bus.refuses(topic.topic):
            return Fault(Quality.COMM_FAULT, Text("mqtt_topic_refused", topic=topic.topic, hint=REFUSED_HINT)), 0.0
        if message is None:
            return Fault(Quality.COMM_FAULT, Text("mqtt_no_message", topic=topic.topic)), 0.0
        value, measured = topic.read(message.payload)
        if isinstance(value, Fault):
            return value, 0.0
        if measured is None and message.retained:
            kept = Text("mqtt_kept", topic=topic.topic)
            return Fault(Quality.STALE, Text("mqtt_age_unknown", kept=kept)), monotonic() - message.arrived_s
        found = _Found(value, measured, message.arrived_s)
        newest = self._newest.get(name, found)
        if measured is not None and newest.measured is not None and newest.measured > measured:
            judged = self._aged(newest)  # it has overtaken this one
            if not isinstance(judged[0], Fault):
                return judged
        self._newest[name] = found
        return self._aged(found)

    def _aged(self, found: "_Found") -> tuple[float | Fault, float]:
        limit_s, arrived_s = self._max_age_s, monotonic() - found.arrived_s
        told_s = arrived_s if found.measured is None else (self._clock.utc() - found.measured).total_seconds()
        if told_s < -limit_s:
            return Fault(Quality.STALE, Text("mqtt_ahead", ahead_s=-told_s)), 0.0
        age_s = max(told_s, arrived_s)  # whatever the clocks say, it was measured before it arrived
        if age_s > limit_s:
            how = Text("mqtt_by_payload") if told_s > arrived_s else Text("mqtt_by_arrival")
            return Fault(Quality.STALE, Text("mqtt_old", age_s=age_s, how=how)), age_s
        return found.value, age_s


@dataclass(frozen=True, slots=True)
class _Found:
    """What a message holds."""

    value: float
    measured: datetime | None
    """UTC, by the message."""
    arrived_s: float
    """Monotonic."""
