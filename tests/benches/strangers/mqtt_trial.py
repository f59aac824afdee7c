"""Reads a drawn MQTT broker with the gateway's acquisition and with a plain client, and compares.

On simulated time and not on a driven loop: the library has a thread and sockets of its own.
"""

import asyncio
import json
import random
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from datetime import UTC, datetime
from functools import cache
from pathlib import Path

from drivers.build import make_device
from gateway.acquisition.line import Line
from gateway.model.sample import Sample
from gateway.runtime.clocks import RealClock
from tests.benches.buses import make_bus
from tests.benches.mqtt_packets import packet, received
from tests.benches.simulated_time import simulated_time
from tests.benches.strangers.least_readings import FEW, READ
from tests.benches.strangers.mqtt_broker import ForeignBroker, MqttNature, age_s, drawn, told
from tests.benches.strangers.polled import Polled

PERIODS = 40
WITHIN = 20
"""So many periods the gateway has to get to know a broker."""
_STEP_S = 0.05
_PATIENCE_S = 5.0
_MARGIN = 0.8
"""A value is certainly good until it has this share of the age that it may have."""


@cache
def _profile(topics: int, timed: bool, max_age_s: float) -> str:
    path = Path(tempfile.mkdtemp(prefix="strangers")) / "topics.toml"
    text = f'protocol = "mqtt"\ntitle = "some topics"\nunit = "1"\nmax_age_s = {max_age_s}\n'
    time = 'time = "t"\n' if timed else ""
    path.write_text(text + "".join(f'[[topic]]\ntopic = "t{i}"\nnumber = "v"\n{time}' for i in range(topics)))
    return str(path)


class MqttTrial:
    """One seed."""

    def __init__(self, nature: MqttNature, seed: int) -> None:
        self.nature, self.seed = nature, seed
        self.lasts_s = PERIODS * nature.period_s
        self.max_age_s = 2.5 * nature.period_s
        self.ours = Polled(self._wrong)
        self.said, self.notices = self.ours.said, self.ours.notices
        self.plain: list[float] = []
        """When a plain client had values of all topics, s after the beginning."""
        self._shown: dict[str, float] = {}
        """When what each channel has shown last was measured."""

    def run(self) -> None:
        with simulated_time():
            asyncio.run(self._gateway())
            asyncio.run(self._plain())

    async def _gateway(self) -> None:
        nature, self._began_s = self.nature, asyncio.get_running_loop().time()
        broker = ForeignBroker(nature, random.Random(self.seed))
        url = f"mqtt://127.0.0.1:{await broker.start()}"
        bus = make_bus("bus", "mqtt", {"url": url, "timeout_s": nature.timeout_s})
        channels = {str(i): i for i in range(nature.topics)}
        profile, clock = _profile(nature.topics, nature.timed, self.max_age_s), RealClock()
        driver = make_device("d", bus, profile, 1, channels, {}, clock)
        await self.ours.run(Line(bus, (driver,), nature.period_s), clock, self.lasts_s)
        await broker.stop()

    def _wrong(self, sample: Sample, at_s: float, _: float) -> str:
        nature = self.nature
        if told(sample.value) != int(sample.channel):
            return f"shows topic {told(sample.value)}"
        old_s = age_s(sample.value, self._began_s + at_s)
        measured_s = at_s - old_s
        before_s = self._shown.get(sample.channel, measured_s)
        self._shown[sample.channel] = measured_s
        if nature.timed and measured_s < before_s - _STEP_S:
            return f"goes back by {before_s - measured_s:.2f} s"
        cannot_tell = not nature.timed and (nature.burst in ("held", "frozen") or nature.overtaken)
        if not cannot_tell and old_s > self.max_age_s + max(0.0, nature.clock_s) + _STEP_S:
            return f"is {old_s:.2f} s old"
        return ""

    async def _plain(self) -> None:
        nature, loop = self.nature, asyncio.get_running_loop()
        began_s = due_s = loop.time()
        broker = ForeignBroker(nature, random.Random(self.seed))
        port = await broker.start()
        values: dict[int, tuple[float, float]] = {}
        hearing: asyncio.Task[None] | None = None
        while loop.time() < began_s + self.lasts_s:
            await asyncio.sleep(max(0.0, due_s - loop.time()))
            if hearing is None or hearing.done():
                hearing = asyncio.create_task(self._hears(port, values))
            await asyncio.sleep(0.5 * nature.period_s)
            now_s, most_s = loop.time(), _MARGIN * self.max_age_s
            ages = [(age_s(value, now_s), now_s - by_clock_s) for value, by_clock_s in values.values()]
            if len(ages) == nature.topics and all(one < most_s and -most_s < told < most_s for one, told in ages):
                self.plain.append(due_s - began_s)
            due_s += nature.period_s
        if hearing is not None:
            hearing.cancel()
            await asyncio.wait((hearing,))
        await broker.stop()

    async def _hears(self, port: int, values: dict[int, tuple[float, float]]) -> None:
        """Keeps each topic's latest value, and when it was measured by what it says, until the connection ends."""
        loop, nature = asyncio.get_running_loop(), self.nature
        with suppress(OSError, asyncio.IncompleteReadError, TimeoutError):
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            try:
                async with asyncio.timeout(_PATIENCE_S):
                    writer.write(packet(0x10, b"\x00\x04MQTT\x04\x02\x00\x3c\x00\x05plain"))
                    await received(reader)
                    names = [b"t%d" % topic for topic in range(nature.topics)]
                    wanted = b"".join(len(name).to_bytes(2, "big") + name + b"\x01" for name in names)
                    writer.write(packet(0x82, b"\x00\x01" + wanted))
                    await received(reader)
                while True:
                    first, body = await received(reader)
                    if first >> 4 != 3:
                        continue
                    length = int.from_bytes(body[:2], "big")
                    after = 2 + length + (2 if first & 6 else 0)
                    if first & 6:
                        writer.write(b"\x40\x02" + body[after - 2 : after])
                    found, topic, now_s = json.loads(body[after:]), int(body[3 : 2 + length]), loop.time()
                    behind_s = 0.0
                    if nature.timed:
                        behind_s = (datetime.now(UTC) - datetime.fromisoformat(found["t"])).total_seconds()
                    if found["v"] is None or (first & 1 and not nature.timed):
                        values.pop(topic, None)
                    else:
                        values[topic] = float(found["v"]), now_s - behind_s
            finally:
                writer.close()

    def problems(self) -> Iterator[str]:
        """What is not as it must be."""
        yield from self.ours.wrong[:3]
        since_s = WITHIN * self.nature.period_s
        theirs = sum(s >= since_s for s in self.plain)
        ours = min(self.ours.readings(str(i), since_s) for i in range(self.nature.topics))
        if ours < READ * theirs - FEW:
            yield f"{ours} readings, a plain client has {theirs}"
        nature = self.nature
        is_heard = not (nature.mute_s or nature.lingers_s or nature.closes_s or nature.closes_after or nature.overtaken)
        lasts = nature.burst_s > self.max_age_s + 3 * max(nature.period_s, nature.interval_s)
        causes = {"null": "mqtt_no_number_at", "silent": "mqtt_old", **({"frozen": "mqtt_old"} if nature.timed else {})}
        cause, reads = causes.get(nature.burst), self.lasts_s > nature.every_s and not nature.clock_s
        if cause and is_heard and lasts and reads and not self.ours.says(cause):
            yield f"nothing says {cause}"


def tried(seed: int) -> MqttTrial:
    """The trial of that seed."""
    trial = MqttTrial(drawn(random.Random(seed)), seed)
    trial.run()
    return trial
