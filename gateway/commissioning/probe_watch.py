"""`talc-gateway probe --watch`: reads the devices repeatedly; a table on a terminal, lines elsewhere."""

import asyncio
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from itertools import pairwise
from statistics import median

from rich.console import Console, RenderableType
from rich.live import Live
from rich.text import Text

from drivers.base import Quality, Reading
from gateway.acquisition.acquisition import Acquisition
from gateway.acquisition.build import lines_of
from gateway.acquisition.line import Line
from gateway.acquisition.text import reading_text
from gateway.config.model import GatewayConfig
from gateway.model.notice import Notice, Notify
from gateway.runtime.clocks import RealClock, ServiceClock
from gateway.runtime.signals import stop_on_signals, until
from gateway.runtime.terminal import duration_text, terminal

_WINDOW = 60
"""Number of reads over which rate and jitter are computed."""
_TABLE_EVERY_S = 0.5
_LINES_EVERY_S = 10.0
_CELL = 17 + 1 + 14 + 1 + 6
"""Width of one channel, so that two fit side by side on 80 columns."""


@dataclass(slots=True)
class DeviceFigures:
    """How one device has answered so far."""

    name: str
    bus: str
    channels: tuple[str, ...]
    answers: deque[float] = field(default_factory=lambda: deque(maxlen=_WINDOW))
    """Monotonic seconds at which the last answered reads ended, except the very first read, which is made immediately,
    outside the bus's schedule, and opens the connection."""
    answered_at: float | None = None
    """Monotonic seconds of the last one, including the first read."""
    periods: int = 0
    """Number since the start."""
    lost: int = 0
    """Periods without an answer since the start."""
    error: str = ""
    """Text of the last error."""
    error_at: float = 0.0
    latest: dict[str, Reading] = field(default_factory=dict)
    good_at: dict[str, float] = field(default_factory=dict)
    """Channel to the monotonic seconds of its last good value."""

    def take(self, readings: Sequence[Reading], now_s: float) -> None:
        """The readings of one period.

        now_s: monotonic, when they came; their own times are those of the values, of which some are older
        """
        self.periods += 1
        self.latest |= {reading.channel: reading for reading in readings}
        self.good_at |= {r.channel: r.monotonic_s for r in readings if r.quality.usable}
        first = readings[0]
        if all(reading.quality is Quality.COMM_FAULT for reading in readings):
            self.lost += 1
            self._fails(first.detail, first.monotonic_s)
        else:
            self.answered_at = first.monotonic_s
            if self.periods > 1:
                self.answers.append(now_s)
            for reading in readings:
                if reading.detail:
                    self._fails(f"{reading.channel}: {reading.detail}", reading.monotonic_s)

    def expire(self, readings: Sequence[Reading], now_s: float) -> None:
        """Channels that have gone stale because a read hangs: it has not ended, so no period is counted."""
        for reading in readings:
            self.latest[reading.channel] = reading
            self._fails(f"{reading.channel}: {reading.detail}", now_s)

    def _fails(self, text: str, now_s: float) -> None:
        self.error, self.error_at = text, now_s

    @property
    def good(self) -> int:
        return sum(reading.quality.usable for reading in self.latest.values())

    @property
    def complete(self) -> bool:
        """Whether every channel is good."""
        return self.good == len(self.channels)

    @property
    def rate_hz(self) -> float | None:
        """Answers per second over the last reads; None until there are two."""
        if len(self.answers) < 2:
            return None
        return (len(self.answers) - 1) / (self.answers[-1] - self.answers[0])

    @property
    def jitter_s(self) -> float | None:
        """How far the worst interval between two answers deviates from the usual one."""
        times = list(self.answers)
        intervals = [after - before for before, after in pairwise(times)]
        if not intervals:
            return None
        usual = median(intervals)
        return max(abs(interval - usual) for interval in intervals)


class ProbeView:
    """What is shown, and how. Independent of the terminal."""

    def __init__(self, machine: str, lines: Sequence[Line], now: Callable[[], float]) -> None:
        """now: monotonic seconds"""
        self._machine, self._lines, self._now, self._began = machine, lines, now, now()
        self.devices = [
            DeviceFigures(driver.device, line.bus.name, driver.channels) for line in lines for driver in line.drivers
        ]
        self._of_channel = {channel: device for device in self.devices for channel in device.channels}

    def take(self, readings: Sequence[Reading]) -> None:
        """The readings of one device."""
        if readings:
            self._of_channel[readings[0].channel].take(readings, self._now())

    def expire(self, readings: Sequence[Reading]) -> None:
        """Channels of any device that have gone stale."""
        for reading in readings:
            self._of_channel[reading.channel].expire([reading], self._now())

    def reading(self, clock: ServiceClock, notify: Notify) -> Acquisition:
        """What reads the devices as `run` does, and tells this view."""
        return Acquisition(self._lines, clock, self.take, notify, quiet=True, expired=self.expire)

    @property
    def all_good(self) -> bool:
        return all(device.complete for device in self.devices)

    def table(self, now_s: float, width: int, height: int) -> Text:
        """Table for a terminal of this size. Channels that are not good come first when there is no room for all."""
        good, channels = sum(d.good for d in self.devices), len(self._of_channel)
        ran = duration_text(now_s - self._began, tenths=True)
        head = f"{self._machine}  {good} of {channels} good  {ran}  Ctrl-C ends"
        titles = _columns("device", "bus", "good", "rate", "jitter", "lost", "age")
        top = [Text(head[:width], style="bold"), Text(titles[:width])]
        top += [Text(self._device(d, now_s)[:width], style="" if d.complete else "red") for d in self.devices]
        for device in self.devices:
            if device.error:
                text = f"{device.name}, {duration_text(now_s - device.error_at, tenths=True)} ago: {device.error}"
                top += Text(text, style="dim" if device.complete else "red").wrap(_PLAIN, width)[:2]
        return Text("\n").join([*top, Text(""), *self._rows(now_s, width, max(1, height - len(top) - 2))])

    def lines(self, now_s: float) -> Iterator[str]:
        """One line per device, for a log or a pipe."""
        for device in self.devices:
            values = " ".join(f"{channel}={reading_text(device.latest.get(channel))}" for channel in device.channels)
            rate, jitter = _rate(device.rate_hz), _milliseconds(device.jitter_s)
            counted = f"{device.good}/{len(device.channels)} good, {rate}, jitter {jitter}, {device.lost} lost"
            at_s = device.answered_at
            age = "" if at_s is None else f", age {duration_text(now_s - at_s, tenths=True)}"
            yield f"{device.bus} {device.name}: {counted}{age}: {values}"

    def _device(self, device: DeviceFigures, now_s: float) -> str:
        age = "never" if device.answered_at is None else duration_text(now_s - device.answered_at, tenths=True)
        count = f"{device.good}/{len(device.channels)}"
        rate, jitter = _rate(device.rate_hz), _milliseconds(device.jitter_s)
        return _columns(device.name, device.bus, count, rate, jitter, str(device.lost), age)

    def _rows(self, now_s: float, width: int, room: int) -> list[Text]:
        cells = [self._cell(device, channel, now_s) for device in self.devices for channel in device.channels]
        beside = max(1, (width + 2) // (_CELL + 2))
        if (len(cells) + beside - 1) // beside > room:
            cells.sort(key=lambda cell: not cell.style)  # stable: the rest stays in file order
            cells, left = cells[: beside * (room - 1)], cells[beside * (room - 1) :]
            cells.append(Text(f"... and {len(left)} more, {sum(not cell.style for cell in left)} of them good"))
        return [Text("  ").join(cells[start : start + beside]) for start in range(0, len(cells), beside)]

    def _cell(self, device: DeviceFigures, channel: str, now_s: float) -> Text:
        reading = device.latest.get(channel)
        since = device.good_at.get(channel)
        age = "never" if since is None else duration_text(now_s - since, tenths=True)
        good = reading is not None and reading.quality.usable
        text = f"{reading_text(reading):>9}{_unit(reading):<5}" if good else reading_text(reading)
        return Text(f"{_fitted(channel, 17):<17} {text:>14.14} {age:>6.6}", style="" if good else "red")


_PLAIN = Console(width=80)
"""Wraps text; prints nothing."""


def _fitted(name: str, width: int) -> str:
    """A long name without its middle, because names on one machine differ at their ends."""
    return name if len(name) <= width else f"{name[: width // 2]}…{name[width // 2 + 1 - width :]}"


def _columns(device: str, bus: str, good: str, rate: str, jitter: str, lost: str, age: str) -> str:
    return f"{_fitted(device, 18):<18} {_fitted(bus, 10):<10} {good:>7} {rate:>8} {jitter:>8} {lost:>6} {age:>8}"


def _unit(reading: Reading | None) -> str:
    return f" {reading.unit}" if reading is not None and reading.quality.usable else ""


def _rate(hertz: float | None) -> str:
    return "-" if hertz is None else f"{hertz:.2f} Hz"


def _milliseconds(seconds: float | None) -> str:
    return "-" if seconds is None else f"{seconds * 1e3:.0f} ms"


def watch_channels(config: GatewayConfig, seconds: float | None, every_s: float | None) -> bool:
    """Show until Ctrl-C or for the given seconds; True if every channel was good at the end.

    every_s: interval between updates; None: twice a second on a terminal, every 10 s elsewhere
    """
    return asyncio.run(_watch(config, seconds, every_s))


async def _watch(config: GatewayConfig, seconds: float | None, every_s: float | None) -> bool:
    console = terminal()
    clock = RealClock()
    view = ProbeView(config.machine.name, lines_of(config, clock), clock.monotonic)
    stop = asyncio.Event()
    stop_on_signals(stop)
    on_terminal = console.is_terminal

    def noticed(notice: Notice) -> None:
        if not on_terminal:
            _say(console, notice.text)

    def screen() -> RenderableType:
        return view.table(clock.monotonic(), console.width, console.height)

    every_s = every_s or (_TABLE_EVERY_S if on_terminal else _LINES_EVERY_S)
    live = Live(screen(), console=console, auto_refresh=False, screen=False, vertical_overflow="crop")
    async with view.reading(clock, noticed):
        with live if on_terminal else nullcontext():
            async for _ in until(stop, every_s, seconds):
                if on_terminal:
                    live.update(screen(), refresh=True)
                else:
                    for line in view.lines(clock.monotonic()):
                        _say(console, line)
    return view.all_good


def _say(console: Console, text: str) -> None:
    console.print(f"{RealClock().utc():%H:%M:%S} {text}", highlight=False, soft_wrap=True)
