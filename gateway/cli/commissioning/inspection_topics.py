"""`talc-gateway inspect topics`: what passes through an MQTT broker, and the draft of a profile. It only subscribes."""

import asyncio
import math
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import click
from rich.table import Table

from drivers.mqtt import MqttBus, MqttBusSettings, TopicMessage
from drivers.problems import read_settings
from drivers.section import LONGEST_ANSWER_S
from gateway.acquisition.text import number_text
from gateway.cli.commissioning.inspection import Draft, new_file, now_text, write_draft
from gateway.cli.conventions.arguments import FiniteNumber
from gateway.cli.conventions.exits import EXIT_WORLD
from gateway.cli.conventions.terminal import printable, terminal
from gateway.commissioning.scan.found import open_bus
from gateway.commissioning.scan.topics import SeenTopic, bus_period_s, seen_topics, topic_draft
from gateway.config.wires import toml_value
from gateway.runtime.boundary import contained

_MOST_SHOWN = 60
"""Characters of a payload."""


@click.command("topics")
@click.argument("url")
@click.argument("topics", nargs=-1)
@click.option("--seconds", type=FiniteNumber(min=0.1), default=10.0, show_default=True, help="How long to listen.")
@click.option("--most", type=click.IntRange(1), default=1000, show_default=True,
              help="Stop when this many topics have had a message.")  # fmt: skip
@click.option("--user", help="User name; needs --password-file. Default: anonymous.")
@click.option("--password-file", help="File that contains only the user's password.")
@click.option(
    "--authority", help="Certificates of the authority that issued the broker's. Default: those that the system trusts."
)
@click.option("--certificate", help="This client's certificate; needs --key.")
@click.option("--key", help="The certificate's key.")
@click.option("--client-id", help="Client identifier, if the broker's rules need one.")
@click.option(
    "--allow-unencrypted", is_flag=True, help="Allow mqtt:// beyond this computer, where everyone can read it."
)
@click.option("--timeout", "timeout_s", type=FiniteNumber(0.01, LONGEST_ANSWER_S), default=5.0, show_default=True)
@Draft
@click.option(
    "--scale", type=FiniteNumber(), default=1.0, show_default=True, help="Scale in the draft: value = number * scale."
)
@click.option("--quantity", default="degC", show_default=True, help="Unit of the values in the draft.")
def topics_command(
    url: str, topics: tuple[str, ...], seconds: float, most: int, user: str | None, password_file: str | None,
    authority: str | None, certificate: str | None, key: str | None, client_id: str | None, allow_unencrypted: bool,
    timeout_s: float, draft: Path | None, scale: float, quantity: str,
) -> None:  # fmt: skip
    """Listen to TOPICS ('hall/#', 'hall/+/temperature'; all by default) of the MQTT broker at URL (mqtts://host:port).

    Shows each number in the latest payload of each topic, where it is, and how old the payload's own time says it is.
    """
    new_file(draft)
    given: dict[str, object] = {
        "url": url, "user": user, "password_file": password_file, "authority": authority, "certificate": certificate,
        "key": key, "client_id": client_id, "allow_unencrypted": allow_unencrypted, "timeout_s": timeout_s,
    }  # fmt: skip
    known = {name: value for name, value in given.items() if value not in (None, False)}
    bus = MqttBus("inspect", read_settings(MqttBusSettings, known))
    bus.want(topics or ("#",))
    heard = asyncio.run(_listen(bus, seconds, most))
    seen = seen_topics(heard, datetime.now(UTC))
    console = terminal()
    if seen:
        console.print(_table(seen, printable(url)))
    else:
        console.print(f"no message in {seconds:g} s", highlight=False)
    if len(seen) >= most:
        console.print(f"stopped at {most} topics; name fewer, or give --most", highlight=False)
    if draft is not None and seen:
        try:
            text = topic_draft(seen, scale=scale, unit=quantity, place=url, when=now_text())
        except ValueError as error:
            raise click.UsageError(f"{error}: no draft was written") from error
        lines = [f"{name} = {toml_value(value)}" for name, value in known.items() if name != "timeout_s"]
        write_draft(draft, text, 1)
        head = ["[[bus]]  # of the device above; CONFIRM: the longest usual time between messages", 'name = "..."']
        click.echo("\n".join([*head, 'kind = "mqtt"', *lines, f"period_s = {bus_period_s(seen)}"]))
    sys.exit(0 if seen else EXIT_WORLD)


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
