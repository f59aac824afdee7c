"""Looks for numbers and times in what MQTT topics hold, and drafts a profile of them."""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import get_args

from drivers.mqtt.bus import TopicMessage
from drivers.mqtt.profile import TimeUnit, instant_in, number_in
from gateway.commissioning.scan.drafts import draft_text
from gateway.config.wires import toml_value
from gateway.model.codes import NoticeCode
from gateway.model.text import Text

_TIME_UNITS: tuple[TimeUnit, ...] = get_args(TimeUnit)
_NEAR = timedelta(days=3650)
"""A number that is an instant this near the present is a time; a temperature or a count is not."""
_DEEPEST = 8
_AGES = 3
"""A value may be as old as this many periods of the bus."""


@dataclass(frozen=True, slots=True)
class SeenNumber:
    """A number in a payload."""

    place: str | None
    """As a profile names it; None: the whole payload."""
    value: float


@dataclass(frozen=True, slots=True)
class SeenTime:
    """What is probably the time of a payload."""

    place: str
    unit: TimeUnit | None
    """Unit of a number; None: ISO 8601."""
    age_s: float


@dataclass(frozen=True, slots=True)
class SeenTopic:
    """One topic, and what its latest payload may mean."""

    topic: str
    payload: bytes
    count: int
    every_s: float
    """Mean interval of its messages; NaN with fewer than two."""
    retained: bool
    """Whether the broker had kept the latest."""
    numbers: tuple[SeenNumber, ...]
    times: tuple[SeenTime, ...]

    @property
    def time(self) -> SeenTime | None:
        """The one nearest to the present: others may be of a calibration or a start."""
        return min(self.times, key=lambda time: abs(time.age_s), default=None)

    @property
    def kind(self) -> str:
        """The kind of the payload."""
        if self.numbers and self.numbers[0].place is None:
            return "number"
        if not self.payload:
            return "empty"
        try:
            json.loads(self.payload)
        except (ValueError, RecursionError):
            return "text" if self.payload.decode(errors="replace").isprintable() else f"{len(self.payload)} bytes"
        return "JSON"


def seen_topics(heard: Mapping[str, TopicMessage], now: datetime) -> list[SeenTopic]:
    """What the latest payload of each topic may mean, by name; now: aware."""
    return [_seen(topic, heard[topic], now) for topic in sorted(heard)]


def _seen(topic: str, message: TopicMessage, now: datetime) -> SeenTopic:
    try:
        content = json.loads(message.payload)
    except (ValueError, RecursionError):
        content = None
    numbers, times = list[SeenNumber](), list[SeenTime]()
    for place, found in _leaves(content, ()):
        time = None if not place else _time(".".join(place), found, now)
        value = number_in(found)
        if time is not None:
            times.append(time)
        elif value is not None:
            numbers.append(SeenNumber(".".join(place) if place else None, value))
    return SeenTopic(
        topic=topic,
        payload=message.payload,
        count=message.count,
        every_s=(message.arrived_s - message.first_s) / (message.count - 1) if message.count > 1 else math.nan,
        retained=message.retained,
        numbers=tuple(numbers),
        times=tuple(times),
    )


def _leaves(content: object, place: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], object]]:
    """What is neither an object nor a list, and where; what a profile cannot name is left out."""
    if isinstance(content, dict | list):
        named = content.items() if isinstance(content, dict) else ((str(i), one) for i, one in enumerate(content))
        for name, one in named:
            if name and "." not in name and len(place) < _DEEPEST:
                yield from _leaves(one, (*place, name))
    else:
        yield place, content


def _time(place: str, found: object, now: datetime) -> SeenTime | None:
    """A text is a time if it is a date with a time of day; a number if it is near the present in some unit."""
    is_text = isinstance(found, str)
    if is_text and ":" not in str(found):
        return None  # a day alone, or a number as text; a profile reads times as text only in ISO 8601
    for unit in ("s",) if is_text else _TIME_UNITS:
        time = instant_in(found, unit)
        if time is not None and abs(time - now) < _NEAR:
            return SeenTime(place, None if is_text else unit, (now - time).total_seconds())
    return None


def bus_period_s(seen: Sequence[SeenTopic]) -> int:
    """For the bus of a draft: the longest interval between messages with a number, in whole seconds; 1 if unknown."""
    intervals = [topic.every_s for topic in seen if topic.numbers and not math.isnan(topic.every_s)]
    return max(1, math.ceil(max(intervals, default=0.0)))


def topic_draft(seen: list[SeenTopic], *, scale: float, unit: str, place: str, when: str) -> str:
    """A profile of every number of these topics. Raises ValueError if there is none.

    Each with its payload's time, if there is one; max_age_s is three times `bus_period_s`.
    """
    blocks = []
    for topic in seen:
        for number in topic.numbers:
            lines = ["[[topic]]", f"# seen: {number.value:g}", f"topic = {toml_value(topic.topic)}"]
            lines += [] if number.place is None else [f"number = {toml_value(number.place)}"]
            time = topic.time
            if time is not None:
                lines.append(f"time = {toml_value(time.place)}  # {time.age_s:.0f} s old when it was seen")
                lines += [f"time_unit = {toml_value(time.unit)}"] if time.unit not in (None, "s") else []
            blocks.append([*lines, *([] if scale == 1 else [f"scale = {scale!r}"])])
    if not blocks:
        raise ValueError(Text(NoticeCode.NO_TOPIC_NUMBER))
    oldest_s = _AGES * bus_period_s(seen)
    return draft_text("mqtt", "max_age_s, scale and unit", unit, blocks, place, when, (f"max_age_s = {oldest_s}",))
