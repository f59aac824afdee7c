"""Topics of an MQTT broker as the channels of a device."""

from collections.abc import Mapping, Sequence
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
        self._maker = ReadingMaker({name: topic.unit or profile.unit for name, topic in self._topics.items()}, clock)
        bus.want(self._names)

    async def connect(self) -> None:
        """Nothing to ask: a topic may be silent for long."""

    async def read(self, *, again: bool = False) -> Sequence[Reading]:  # noqa: ARG002
        """One reading per channel, as old as its payload says. Raises ConnectError."""
        latest = await self._bus.latest(self.device, self._names)
        return self._maker.make_aged(
            {name: self._judged(topic, latest.get(topic.topic)) for name, topic in self._topics.items()}
        )

    async def close(self) -> None:
        """Nothing to close: the connection is the bus's."""

    def _judged(self, topic: MqttTopic, message: TopicMessage | None) -> tuple[float | Fault, float]:
        """The value and its age, s."""
        if self._bus.refuses(topic.topic):
            return Fault(Quality.COMM_FAULT, Text("mqtt_topic_refused", topic=topic.topic, hint=REFUSED_HINT)), 0.0
        if message is None:
            return Fault(Quality.COMM_FAULT, Text("mqtt_no_message", topic=topic.topic)), 0.0
        value, measured = topic.read(message.payload)
        if isinstance(value, Fault):
            return value, 0.0
        limit_s, arrived_s = self._max_age_s, monotonic() - message.arrived_s
        told_s = arrived_s if measured is None else (self._clock.utc() - measured).total_seconds()
        if measured is None and message.retained:
            kept = Text("mqtt_kept", topic=topic.topic)
            return Fault(Quality.STALE, Text("mqtt_age_unknown", kept=kept)), arrived_s
        if told_s < -limit_s:
            return Fault(Quality.STALE, Text("mqtt_ahead", ahead_s=-told_s)), 0.0
        age_s = max(told_s, arrived_s)  # whatever the clocks say, it was measured before it arrived
        if age_s > limit_s:
            how = Text("mqtt_by_payload") if told_s > arrived_s else Text("mqtt_by_arrival")
            return Fault(Quality.STALE, Text("mqtt_old", age_s=age_s, how=how)), age_s
        return value, age_s
