"""Profiles of MQTT topics: which are channels, and where their payloads hold the value and its time."""

import json
import math
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from typing import Annotated, ClassVar, Final, Literal

from pydantic import Field

from drivers.base import Quality
from drivers.faults import Fault
from drivers.number_types import WRITTEN_NUMBER
from drivers.profile import DeviceProfile, LinearValue
from drivers.section import NotEmpty, Positive, matching
from drivers.text import Text, shown

TimeUnit = Literal["s", "ms", "us", "ns"]
_TWICE: Final = object()
_PER_SECOND: dict[TimeUnit, float] = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}
MOST_BYTES = 65_536
"""Largest size of a payload."""


class MqttTopic(LinearValue):
    """One channel: value = number * scale + offset."""

    topic: Annotated[str, Field(max_length=1000), matching(r"[^+#\x00]+", "mqtt_a_topic")]
    """The topic, with all its levels."""
    number: NotEmpty | None = None
    """Where the number is in a JSON payload: names, and numbers of list elements, separated by dots, such as
    `sensors.0.temperature`; a name may have dots itself. None: the payload is the number itself."""
    time: NotEmpty | None = None
    """Where the payload holds the time at which the value was measured, in the same form: ISO 8601, or a number since
    1970. None: the age counts from the arrival of the message."""
    time_unit: TimeUnit = "s"
    """Unit of a time that is a number."""

    def read(self, payload: bytes) -> tuple[float | Fault, datetime | None]:
        """The value and its time, UTC, or what is wrong."""
        if len(payload) > MOST_BYTES:
            return Fault(Quality.SENSOR_FAULT, Text("mqtt_long", most=MOST_BYTES)), None
        payload = payload.rstrip(b"\0")  # of a text that its sender counts with its end
        plain = payload.decode("ascii", "replace").strip()
        try:
            is_plain = self.number is None and WRITTEN_NUMBER.fullmatch(plain)
            content = plain if is_plain else json.loads(payload, object_pairs_hook=_stated)
        except (ValueError, RecursionError):
            return Fault(Quality.SENSOR_FAULT, Text("mqtt_no_json", payload=_quoted(payload))), None
        found = _at(content, self.number)
        number = number_in(found)
        if number is None:
            payload_text = _quoted(payload)
            text = Text("mqtt_no_number", payload=payload_text)
            if self.number:
                text = Text("mqtt_no_number_at", place=str(self.number), payload=payload_text)
            return Fault(Quality.SENSOR_FAULT, text), None
        if self.time is None:
            return self.value(number), None
        measured = instant_in(_at(content, self.time), self.time_unit)
        if measured is None:
            return Fault(Quality.STALE, Text("mqtt_no_time", place=self.time, payload=_quoted(payload))), None
        return self.value(number), measured


class MqttProfile(DeviceProfile):
    """Topics of an MQTT broker."""

    buses: ClassVar[tuple[str, ...]] = ("mqtt",)

    protocol: Literal["mqtt"]
    """`mqtt`."""
    max_age_s: Positive
    """A value older than this is `stale`; at most three times `period_s` of the bus."""
    topics: tuple[MqttTopic, ...] = Field(alias="topic", min_length=1)

    @property
    def oldest_s(self) -> float:
        """`max_age_s`."""
        return self.max_age_s

    @property
    def channels(self) -> int:
        """Number of channels."""
        return len(self.topics)


def _stated(pairs: list[tuple[str, object]]) -> dict[str, object]:
    """An object of JSON. What it states twice and differently is not a number, nor anything else."""
    found: dict[str, object] = {}
    for name, value in pairs:
        found[name] = value if found.get(name, value) == value else _TWICE
    return found


def _at(content: object, path: str | None) -> object:
    """What is at that place; None: nothing, or more than one thing, as names may have dots."""
    if path is None:
        return content
    found = list(_all_at(content, path.split(".")))
    return found[0] if len(found) == 1 else None


def _all_at(content: object, parts: Sequence[str]) -> Iterator[object]:
    if not parts:
        yield content
    elif isinstance(content, dict):
        for end in range(1, len(parts) + 1):
            if (name := ".".join(parts[:end])) in content:
                yield from _all_at(content[name], parts[end:])
    elif isinstance(content, list) and parts[0].isdecimal() and int(parts[0]) < len(content):
        yield from _all_at(content[int(parts[0])], parts[1:])


def instant_in(found: object, unit: TimeUnit) -> datetime | None:
    """An instant, UTC: ISO 8601 (without offset UTC), or a number of `unit` since 1970, also written as text."""
    if isinstance(found, str) and WRITTEN_NUMBER.fullmatch(found.strip()):
        found = float(found)
    try:
        if isinstance(found, str):
            time = datetime.fromisoformat(found)
            return time.astimezone(UTC) if time.tzinfo is not None else time.replace(tzinfo=UTC)
        if isinstance(found, int | float) and not isinstance(found, bool):
            return datetime.fromtimestamp(found / _PER_SECOND[unit], UTC)
    except (ValueError, OverflowError, OSError):
        pass
    return None


def number_in(found: object) -> float | None:
    """A finite number; also one that is written as text, as some devices send it."""
    if isinstance(found, str):
        if not WRITTEN_NUMBER.fullmatch(found.strip()):
            return None
        found = float(found)
    if isinstance(found, bool) or not isinstance(found, int | float):
        return None
    try:
        return float(found) if math.isfinite(found) else None
    except OverflowError:
        return None


def _quoted(payload: bytes) -> str:
    return shown(payload.decode(errors="replace"))
