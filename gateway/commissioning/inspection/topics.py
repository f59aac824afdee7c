"""What passes through an MQTT broker, and the draft of a profile. It only subscribes."""

import asyncio
import math
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime

import click
from rich.table import Table

from drivers.mqtt.bus import MqttBus, TopicMessage
from gateway.acquisition.text import number_text
from gateway.commissioning.inspection.draft import Draft, now_text, write_draft
from gateway.commissioning.scan.found import open_bus
from gateway.commissioning.scan.topics import SeenTopic, bus_period_s, seen_topics, topic_draft
from gateway.config.wires import toml_value
from gateway.runtime.boundary import contained
from gateway.runtime.terminal import printable, terminal

_MOST_SHOWN = 60
"""Characters of a payload."""


def inspect_topics(
    bus: MqttBus,
    settings: Mapping[str, object],
    seconds: float,
    most: int,
    draft: Draft,
) -> bool:
    """Listen to what the bus wants, print a table and write the draft; False if nothing was heard.

    settings: those of the bus that were given, for the draft; `url` is one of them
    """
    heard = asyncio.run(_listen(bus, seconds, most))
    seen = seen_topics(heard, datetime.now(UTC))
    console, url = terminal(), str(settings["url"])
    if seen:
        console.print(_table(seen, printable(url)))
    else:
        console.print(f"no message in {seconds:g} s", highlight=False)
    if len(seen) >= most:
        console.print(f"stopped at {most} topics; name fewer, or give --most", highlight=False)
    if draft.file is not None and seen:
        try:
            text = topic_draft(seen, scale=draft.scale, unit=draft.quantity, place=url, when=now_text())
        except ValueError as error:
            raise click.UsageError(f"{error}: no draft was written") from error
        lines = [f"{name} = {toml_value(value)}" for name, value in settings.items() if name != "timeout_s"]
        write_draft(draft.file, text, 1)
        head = ["[[bus]]  # of the device above; CONFIRM: the longest usual time between messages", 'name = "..."']
        click.echo("\n".join([*head, 'kind = "mqtt"', *lines, f"period_s = {bus_period_s(seen)}"]))
    return bool(seen)


async def _listen(bus: MqttBus, seconds: float, most: int) -> dict[str, TopicMessage]:
    """Raises DriverError."""
    async with open_bus(bus):
        return await contained(bus.heard(seconds, most), "listening")


def _table(seen: Sequence[SeenTopic], title: str) -> Table:
    table = Table("topic", "messages", "every", "payload", "number", "value", "time", "age", title=title,
                  title_justify="left")  # fmt: skip
    for topic in seen:
        count = f"{topic.count}, kept" if topic.retained else f"{topic.count}"
        every = "" if math.isnan(topic.every_s) else f"{topic.every_s:.1f} s"
        head = (printable(topic.topic), count, every, topic.kind)
        time = topic.time
        told = ("", "") if time is None else (f"{time.place}, {time.unit or 'ISO 8601'}", f"{time.age_s:.0f} s")
        rows = [(printable(n.place or "the payload"), number_text(n.value)) for n in topic.numbers]
        if not rows:
            text = printable(topic.payload[: _MOST_SHOWN * 4].decode(errors="replace"))
            rows = [("none", text[:_MOST_SHOWN])]
        for i, row in enumerate(rows):
            table.add_row(*(head if i == 0 else ("",) * len(head)), *row, *told)
    return table
