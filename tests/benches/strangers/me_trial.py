"""Reads a drawn Micro-Epsilon controller with the gateway's acquisition and with a plain client, and compares."""

import asyncio
import random
import struct
from collections.abc import Iterator
from contextlib import suppress

from drivers.build import make_device
from gateway.acquisition.line import Line
from gateway.model.sample import Sample
from tests.benches.buses import make_bus
from tests.benches.strangers.driven_loop import DrivenLoop, LoopClock, run_driven
from tests.benches.strangers.least_readings import FEW, IN_TIME, READ
from tests.benches.strangers.me_host import ForeignController, MeNature, age_s, drawn, told
from tests.benches.strangers.polled import Polled

PERIODS = 50
WITHIN = 20
"""So many periods the gateway has to get to know a controller."""
_STEP_S = 0.02
"""Of the channels' time."""
_RANGE_UM = 0xFFFFFF / 100.0
_PATIENCE_S = 5.0
_HEAD_BYTES = 36
_CAUSES = {
    "frozen": "me_stands_still",
    "other": "me_other_controller",
    "low": "me_before_range",
    "high": "me_after_range",
}
"""What is said of some bursts."""


class MeTrial:
    """One seed."""

    def __init__(self, nature: MeNature, seed: int) -> None:
        self.nature, self.seed = nature, seed
        self.lasts_s = PERIODS * nature.period_s
        self.ours = Polled(self._wrong)
        self.said, self.notices = self.ours.said, self.ours.notices
        self.plain: list[float] = []
        """When it had read all, s after the beginning, and within the period and the timeout."""

    def run(self) -> None:
        run_driven(self._gateway)
        run_driven(self._plain)

    def _host(self, loop: DrivenLoop) -> None:
        self._began_s = loop.time()
        loop.hosts["host"] = ForeignController(loop, self.nature, random.Random(self.seed))

    async def _plain(self, loop: DrivenLoop) -> None:
        self._host(loop)
        began_s = due_s = loop.time()
        ear, line = None, None
        while (now_s := loop.time()) < began_s + self.lasts_s:
            await asyncio.sleep(due_s - now_s)
            if ear is None or not ear.is_open:
                with suppress(ConnectionRefusedError):
                    line, ear = await loop.create_connection(_Ear, "host", 10001)
            asked_s = loop.time()
            if ear is not None and await ear.block(loop, self.nature):
                took_s = loop.time() - asked_s
                if took_s < IN_TIME * min(self.nature.period_s, self.nature.timeout_s):
                    self.plain.append(loop.time() - began_s)
            due_s = max(due_s + self.nature.period_s, loop.time())
        if line is not None:
            line.close()

    async def _gateway(self, loop: DrivenLoop) -> None:
        self._host(loop)
        nature, clock = self.nature, LoopClock(loop)
        bus = make_bus("bus", "me_ethernet", {"host": "host", "port": 10001, "timeout_s": nature.timeout_s})
        channels = {str(channel): channel for channel in range(nature.channels)}
        driver = make_device("d", bus, "me_ethernet", 1, channels, {"range_um": _RANGE_UM}, clock)
        await self.ours.run(Line(bus, (driver,), nature.period_s), clock, self.lasts_s)

    def _wrong(self, sample: Sample, at_s: float, last_s: float) -> str:
        found = round(sample.value * 100)
        if told(found)[0] != int(sample.channel):
            return f"shows {found:X} hex"
        old_s = age_s(found, self._began_s + at_s)
        return f"is {old_s:.2f} s old" if old_s > at_s - last_s + _STEP_S else ""

    def problems(self) -> Iterator[str]:
        """What is not as it must be."""
        yield from self.ours.wrong[:3]
        nature, since_s = self.nature, WITHIN * self.nature.period_s
        theirs, ours = sum(s >= since_s for s in self.plain), self.ours.readings("0", since_s)
        if ours < READ * theirs - FEW:
            yield f"{ours} readings, a plain client has {theirs} in time"
        is_heard = not (nature.mute_s or nature.lingers_s or nature.closes_s or nature.loses or nature.noise)
        is_long = nature.burst_s > 3 * max(nature.period_s, nature.block_s) + nature.timeout_s
        is_sent = nature.block_s < nature.timeout_s / 2 and self.lasts_s > nature.every_s
        cause = _CAUSES.get(nature.burst)
        if cause and is_heard and is_long and is_sent and not self.ours.says(cause):
            yield f"nothing says {cause}"


class _Ear(asyncio.Protocol):
    def __init__(self) -> None:
        self.heard, self.is_open, self.told = bytearray(), True, asyncio.Event()

    def data_received(self, data: bytes) -> None:
        self.heard += data
        self.told.set()

    def connection_lost(self, _: Exception | None) -> None:
        self.is_open = False
        self.told.set()

    async def block(self, loop: DrivenLoop, nature: MeNature) -> bool:
        """Whether a new, right block of the same controller comes in time."""
        self.heard.clear()
        until_s, began_s = loop.time() + _PATIENCE_S, loop.time()
        size = _HEAD_BYTES + 4 * nature.channels * nature.frames
        while True:
            at = self.heard.find(b"MEAS")
            while at >= 0 and len(self.heard) >= at + size:
                block = bytes(self.heard[at : at + size])
                values = struct.unpack(f"<{nature.channels}i", block[-4 * nature.channels :])
                serial = int.from_bytes(block[8:12], "little")
                is_new = age_s(values[0], loop.time()) <= loop.time() - began_s + nature.block_s + _STEP_S
                if serial == 4711 and told(values[0])[0] == 0 and is_new:
                    return True
                at = self.heard.find(b"MEAS", at + 4)
            if not self.is_open or loop.time() >= until_s:
                return False
            self.told.clear()
            try:
                async with asyncio.timeout_at(until_s):
                    await self.told.wait()
            except TimeoutError:
                return False


def tried(seed: int) -> MeTrial:
    """The trial of that seed."""
    trial = MeTrial(drawn(random.Random(seed)), seed)
    trial.run()
    return trial
