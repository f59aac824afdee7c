"""`talc-gateway name`: reads the sensors, asks at the terminal, and writes each name into the configuration at once."""

import asyncio
import os
import sys
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from getpass import getuser
from pathlib import Path
from threading import Thread
from typing import Final

import click
import numpy as np

from gateway.acquisition.acquisition import Acquisition
from gateway.acquisition.build import lines_of
from gateway.commissioning.naming.dialogue import Dialogue, Keep
from gateway.commissioning.naming.names import Given, Listed, Names, changes, written
from gateway.commissioning.naming.renamed import confirmed, renamed
from gateway.commissioning.naming.warmed import Track, Warmed, warmed
from gateway.config.model import GatewayConfig
from gateway.config.problems import ConfigError, Problem
from gateway.config.reading import read_text
from gateway.model.codes import NoticeCode
from gateway.model.notice import Notice
from gateway.model.sample import Sample
from gateway.model.text import Language, Text
from gateway.runtime.clocks import RealClock
from gateway.runtime.signals import stop_on_signals, until
from gateway.runtime.terminal import terminal
from gateway.runtime.whole_file import write_whole

_EVERY_S: Final = 0.2
_KEPT: Final = 600
"""Values of a channel: enough to know its noise."""


class _Sensors:
    """What they have read since `again`."""

    def __init__(self) -> None:
        self._read: dict[str, deque[tuple[float, float]]] = {}
        self._units: dict[str, str] = {}

    def take(self, readings: Sequence[Sample]) -> None:
        for reading in readings:
            if reading.quality.usable:
                self._units[reading.channel] = reading.unit
                kept = self._read.setdefault(reading.channel, deque(maxlen=_KEPT))
                if not kept or reading.monotonic_s > kept[-1][0]:
                    kept.append((reading.monotonic_s, reading.value))

    def again(self) -> None:
        self._read.clear()

    @property
    def warmed(self) -> Warmed | None:
        pairs = {name: np.array(kept, dtype=np.float64) for name, kept in self._read.items()}
        return warmed({name: Track(kept[:, 0], kept[:, 1], self._units[name]) for name, kept in pairs.items()})


def name_channels(
    path: Path, config: GatewayConfig, listed: Sequence[Listed], by: str, language: str, *, again: bool
) -> bool:
    """Until every channel has its name, or somebody ends it; True if all have. again: also those of earlier sessions"""
    names, protocol, said = Names.of(config, listed), path.with_suffix(".names.csv"), Language(language)
    if not again:
        names.resume(protocol)

    def keep(given: Given, seen: Warmed | None, back: bool) -> None:
        text = renamed(read_text(path), changes(given, back=back), path)
        if not any(each.device == given.input.device for each in names.left):
            text = confirmed(text, given.input.device)
        earlier = path.read_bytes()
        with _written(path):
            write_whole(path, text.replace("\n", "\r\n") if b"\r\n" in earlier else text)
        try:
            with _written(protocol):
                written(protocol, RealClock().utc(), by or _user(), given, seen, back=back)
        except ConfigError:
            with _written(path):
                write_whole(path, earlier)
            raise

    asyncio.run(_session(config, names, said, keep))
    click.echo(said("naming.done", n=len(names.given), left=len(names.left), file=str(path), protocol=str(protocol)))
    return not names.left


@contextmanager
def _written(path: Path) -> Iterator[None]:
    """Raises ConfigError instead of OSError."""
    try:
        yield
    except OSError as error:
        what = Text(NoticeCode.FILE_NOT_WRITTEN, error=error.strerror or str(error))
        raise ConfigError(path, [Problem("", what)]) from None


def _user() -> str:
    """Who works here, also with sudo."""
    return os.environ.get("SUDO_USER") or getuser()


async def _session(config: GatewayConfig, names: Names, said: Language, keep: Keep) -> None:
    clock, sensors, console = RealClock(), _Sensors(), terminal()
    bell = "\a" if console.is_terminal else ""

    channels = {name: place for place, name in names.now.items()}
    dialogue = Dialogue(names, channels, said, click.echo, keep, sensors.again)
    stop, lines = asyncio.Event(), asyncio.Queue[str | None]()
    stop_on_signals(stop)
    loop = asyncio.get_running_loop()

    def typed(line: str | None) -> None:
        loop.call_soon_threadsafe(lines.put_nowait, line)

    Thread(target=_read_lines, args=(typed,), daemon=True).start()

    def noticed(notice: Notice) -> None:
        click.echo(said.of(notice.text))

    async with Acquisition(lines_of(config, clock), clock, sensors.take, noticed, quiet=True):
        dialogue.begin()
        async for _ in until(stop, _EVERY_S, None):
            while not lines.empty() and not dialogue.ended:
                line = lines.get_nowait()
                if line is None:
                    return
                dialogue.typed(line)
            if dialogue.waiting and (seen := sensors.warmed) is not None:
                if seen.clear:
                    click.echo(bell, nl=False)
                dialogue.moved(seen)
            if dialogue.ended:
                return


def _read_lines(take: Callable[[str | None], object]) -> None:
    """Until the input ends, which is told as None."""
    with suppress(RuntimeError):  # the session has ended
        for line in sys.stdin:
            take(line)
        take(None)
