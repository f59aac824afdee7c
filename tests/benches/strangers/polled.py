"""Lets the gateway's acquisition read drawn devices, and keeps what it has shown and said."""

import asyncio
from collections.abc import Callable, Sequence
from contextlib import suppress
from itertools import count

from drivers.base import Quality
from drivers.text import Text
from gateway.acquisition.line import Line
from gateway.acquisition.runner import BusRunner
from gateway.model.notice import Notice
from gateway.model.sample import Sample
from gateway.runtime.clocks import ServiceClock


class Polled:
    """What the gateway reads of one bus. Times are seconds since the beginning.

    judge: is given each good reading, the time, and the time of the device's last readings; returns what is wrong with
    it, if anything is
    """

    def __init__(self, judge: Callable[[Sample, float, float], str]) -> None:
        self._judge = judge
        self.wrong: list[str] = []
        self.good: dict[str, list[float]] = {}
        """When each channel was good."""
        self.polled: dict[str, list[float]] = {}
        """When each device had readings, by its first channel."""
        self.said: dict[str, int] = {}
        self.notices: list[str] = []
        self._texts: list[Text] = []

    async def run(self, line: Line, clock: ServiceClock, lasts_s: float) -> None:
        """Poll for so long."""
        loop = asyncio.get_running_loop()
        began_s = loop.time()

        def publish(samples: Sequence[Sample]) -> None:
            at_s = loop.time() - began_s
            polls = self.polled.setdefault(samples[0].channel, [])
            for sample in samples:
                if sample.quality is not Quality.GOOD:
                    self._says(sample.detail)
                    continue
                self.good.setdefault(sample.channel, []).append(at_s)
                if wrong := self._judge(sample, at_s, polls[-1] if polls else 0.0):
                    self.wrong.append(f"{at_s:.2f} s: {sample.channel} {wrong}")
            polls.append(at_s)

        def notify(notice: Notice) -> None:
            self.notices.append(f"{loop.time() - began_s:.2f} s: {'end: ' if notice.ended else ''}{notice.text}")

        running = asyncio.ensure_future(BusRunner(line, clock, publish, notify, count(1).__next__, quiet=True).run())
        await asyncio.sleep(lasts_s)
        running.cancel()
        with suppress(asyncio.CancelledError):
            await running

    def _says(self, detail: str) -> None:
        if detail not in self.said and isinstance(detail, Text):
            self._texts.append(detail)
        self.said[detail] = self.said.get(detail, 0) + 1

    def says(self, code: str) -> bool:
        """Whether a channel without a value has ever said this."""
        return any(text.says(code) for text in self._texts)

    def readings(self, channel: str, since_s: float) -> int:
        """How often the channel was good from then on."""
        return sum(at_s >= since_s for at_s in self.good.get(channel, ()))
