"""`talc-gateway record`: reads the devices as `run` does, and records everything that passes on the wires."""

import asyncio
from collections.abc import Sequence
from pathlib import Path

import click

from drivers.base import Reading
from gateway.acquisition.acquisition import Acquisition
from gateway.acquisition.build import lines_of
from gateway.acquisition.wire_log import WireLogWriter, not_recorded
from gateway.config.model import GatewayConfig
from gateway.config.packed import packed_toml
from gateway.model.notice import Notice
from gateway.runtime.clocks import RealClock
from gateway.runtime.signals import stop_on_signals, until
from gateway.runtime.terminal import counted, terminal

_LOOK_EVERY_S = 1.0
"""How often the size of the file is checked."""


def record(config: GatewayConfig, path: Path, seconds: float | None, most_mb: float) -> bool:
    """Record until Ctrl-C, for the given seconds, or up to the given size; False if no channel was ever good.

    Raises OSError if the file cannot be made, and click.UsageError if the configuration has no bus that is recorded.
    """
    missing = not_recorded(config)
    if len(missing) == len(config.buses):
        raise click.UsageError("\n".join(["there is nothing to record", *missing]))
    for text in missing:
        terminal(stderr=True).print(text, style="yellow", highlight=False, soft_wrap=True)
    return asyncio.run(_record(config, path, seconds, most_mb))


async def _record(config: GatewayConfig, path: Path, seconds: float | None, most_mb: float) -> bool:
    console = terminal(stderr=True)
    clock = RealClock()
    stop = asyncio.Event()
    stop_on_signals(stop)
    good: set[str] = set()
    bad: dict[str, str] = {}

    def take(readings: Sequence[Reading]) -> None:
        for reading in readings:
            if reading.quality.usable:
                good.add(reading.channel)
                bad.pop(reading.channel, None)
            else:
                bad[reading.channel] = reading.quality.value

    def noticed(notice: Notice) -> None:
        console.print(f"{clock.utc():%H:%M:%S} {notice.text}", highlight=False, soft_wrap=True)

    most_bytes = round(most_mb * 1e6)
    with WireLogWriter(path, packed_toml(config), clock.utc(), most_bytes=most_bytes) as log:
        lines = lines_of(config, clock, log.tap)
        console.print(
            f"recording {counted(len(lines), 'bus', 'buses')} to {path}; Ctrl-C stops", highlight=False, soft_wrap=True
        )
        async with Acquisition(lines, clock, take, noticed, quiet=True):
            async for _ in until(stop, _LOOK_EVERY_S, seconds):
                if log.ended:
                    break
    if log.ended:
        console.print(f"ended: {log.ended}", style="yellow", highlight=False, soft_wrap=True)
    if log.dropped:
        console.print(f"{log.dropped} lines were lost: the disk was too slow", style="yellow", highlight=False)
    lines_of_each = ", ".join(f"{bus} {counted(count, 'line')}" for bus, count in log.counts.items())
    not_good = f"{counted(len(bad), 'channel')} not good at the end"
    console.print(f"{path}: {lines_of_each}; {not_good}", highlight=False, soft_wrap=True)
    if not good:
        console.print("nothing could be read: no channel was good at any time", style="red", highlight=False)
    return bool(good)
