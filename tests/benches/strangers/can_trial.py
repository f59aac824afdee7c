"""Reads a drawn CANopen node with the gateway's acquisition and with a plain client, and compares."""

import asyncio
import random
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import suppress
from functools import cache
from itertools import pairwise
from pathlib import Path

from drivers.build import make_device
from gateway.acquisition.line import Line
from gateway.model.sample import Sample
from gateway.runtime.clocks import RealClock
from simulators.devices import SlcanAdapter
from simulators.devices.slcan_adapter import CanFrame
from tests.benches.buses import make_bus
from tests.benches.simulated_time import simulated_time
from tests.benches.strangers.can_node import OBJECTS, CanNature, ForeignNode, age_s, drawn, told
from tests.benches.strangers.driven_loop import DrivenLoop, run_driven
from tests.benches.strangers.least_readings import FEW, READ, least_readings
from tests.benches.strangers.polled import Polled

PERIODS = 40
WITHIN = 20
"""So many periods the gateway has to get to know a node."""
_STEP_S = 0.02
"""Of the objects' time."""
_PATIENCE_S = 5.0
_ODD, _HONEST = 5, 6
_TIMES = 4
"""So many intervals of its timer a TPDO may be old."""


@cache
def _profile() -> str:
    path = Path(tempfile.mkdtemp(prefix="strangers")) / "node.toml"
    kinds = ("uint32", "uint32", "uint64")
    path.write_text(
        'protocol = "canopen"\ntitle = "some objects"\nunit = "1"\n'
        + "".join(
            f'[[object]]\nindex = {index}\nsubindex = {sub}\ntype = "{kind}"\n'
            for (index, sub), kind in zip(OBJECTS, kinds, strict=True)
        )
    )
    return str(path)


class CanTrial:
    """One seed."""

    def __init__(self, nature: CanNature, seed: int) -> None:
        self.nature, self.seed = nature, seed
        self.lasts_s = PERIODS * nature.period_s
        self.ours = Polled(self._wrong)
        self.said, self.notices = self.ours.said, self.ours.notices
        self.plain: list[tuple[float, float | None]] = []
        """When each round was due, and how long a plain client took for it; None: it could not."""

    def run(self) -> None:
        run_driven(self._plain)
        with simulated_time():
            asyncio.run(self._gateway())

    async def _plain(self, loop: DrivenLoop) -> None:
        node = ForeignNode(loop, _ODD, self.nature, random.Random(self.seed))
        heard: asyncio.Queue[bytes] = asyncio.Queue()

        def take(frames: Sequence[CanFrame]) -> None:
            for identifier, data in frames:
                if identifier == 0x580 + _ODD:
                    heard.put_nowait(data)

        node.send = take
        due_s = began_s = loop.time()
        while loop.time() < began_s + self.lasts_s:
            await asyncio.sleep(max(0.0, due_s - loop.time()))
            is_read = [await _plainly(loop, node, heard, number) for number in range(self.nature.objects)]
            self.plain.append((due_s - began_s, loop.time() - due_s if all(is_read) else None))
            due_s = max(due_s + self.nature.period_s, loop.time())
        node.stop()

    async def _gateway(self) -> None:
        nature, loop, clock = self.nature, asyncio.get_running_loop(), RealClock()
        nodes = [ForeignNode(loop, _ODD, nature, random.Random(self.seed))]
        if nature.neighbour:
            plain = CanNature(objects=nature.objects)
            nodes.append(ForeignNode(loop, _HONEST, plain, random.Random(self.seed)))
        adapter = SlcanAdapter(nodes)
        for node in nodes:
            node.send = adapter.send
        where = {"interface": "slcan", "channel": await adapter.start(), "timeout_s": nature.timeout_s}
        bus = make_bus("can1", "canopen", where)
        drivers = []
        for node in nodes:
            options = {"transfer": nature.transfer} if node.node == _ODD else {}
            channels = {f"{node.node}.{i}": i for i in range(nature.objects)}
            drivers.append(make_device(f"n{node.node}", bus, _profile(), node.node, channels, options, clock))
        self._began_s = loop.time()
        await self.ours.run(Line(bus, tuple(drivers), nature.period_s), clock, self.lasts_s)
        for node in nodes:
            node.stop()
        await adapter.stop()

    def _wrong(self, sample: Sample, at_s: float, last_s: float) -> str:
        node, number, held = int(sample.channel[0]), int(sample.channel[2:]), int(sample.value)
        if told(held) != (node, number):
            return f"shows {told(held)}"
        sent_s = _TIMES * self.nature.event_s if node == _ODD else 0.0
        old_s = age_s(held, self._began_s + at_s)
        return f"is {old_s:.2f} s old" if old_s > at_s - last_s + sent_s + _STEP_S else ""

    def problems(self) -> Iterator[str]:
        """What is not as it must be."""
        yield from self.ours.wrong[:3]
        nature = self.nature
        since_s = WITHIN * nature.period_s
        ours = min(self.ours.readings(f"{_ODD}.{i}", since_s) for i in range(nature.objects))
        rounds = [took_s for due_s, took_s in self.plain if due_s >= since_s]
        if nature.transfer == "sdo":
            if ours < least_readings(rounds, nature.period_s):
                yield f"{ours} readings, a plain client has {sum(took is not None for took in rounds)} of {len(rounds)}"
        elif (
            not (nature.burst or nature.swallows or nature.slower)
            and nature.took_s + nature.jitter_s < nature.timeout_s
        ) and ours < READ * (PERIODS - WITHIN) - FEW:
            yield f"{ours} readings of {PERIODS - WITHIN}"
        gaps = sorted(b - a for a, b in pairwise(s for s in self.ours.polled.get(f"{_HONEST}.0", ()) if s >= since_s))
        if nature.neighbour and gaps[-len(gaps) // 10 - 1] > 1.2 * nature.period_s:
            yield f"the neighbour is read after up to {gaps[-1]:.2f} s"


async def _plainly(loop: DrivenLoop, node: ForeignNode, heard: asyncio.Queue[bytes], number: int) -> bool:
    """Whether the object is read by a client that waits for 5 s."""
    index, sub = OBJECTS[number]
    until_s, sent_s = loop.time() + _PATIENCE_S, loop.time()
    address = index.to_bytes(2, "little") + bytes((sub,))
    node.on_frame(0x600 + _ODD, b"\x40" + address + bytes(4))
    data, toggle = b"", 0
    with suppress(TimeoutError):
        async with asyncio.timeout_at(until_s):
            while True:
                answer = await heard.get()
                if answer[0] & 0xE0 == 0x40 and answer[1:4] == address and answer[0] & 2:
                    data = answer[4:]
                elif answer[0] & 0xE0 == 0x00 and answer[0] & 0x10 == toggle:
                    data, toggle = data + answer[1 : 8 - (answer[0] >> 1 & 7)], toggle ^ 0x10
                    if not answer[0] & 1:
                        node.on_frame(0x600 + _ODD, bytes((0x60 | toggle,)) + bytes(7))
                        continue
                elif answer[0] & 0xE0 == 0x40 and answer[1:4] == address:
                    node.on_frame(0x600 + _ODD, b"\x60" + bytes(7))
                    continue
                elif answer[0] != 0x80:
                    continue
                held = int.from_bytes(data[:4], "little")
                return (
                    bool(data)
                    and told(held) == (_ODD, number)
                    and age_s(held, loop.time()) <= (loop.time() - sent_s + _STEP_S)
                )
    return False


def tried(seed: int) -> CanTrial:
    """The trial of that seed."""
    trial = CanTrial(drawn(random.Random(seed)), seed)
    trial.run()
    return trial
