"""Reads a drawn Modbus device with the gateway's acquisition and with a plain client, and compares."""

import random
import tempfile
from collections.abc import Iterator, Sequence
from functools import cache
from itertools import pairwise
from pathlib import Path

from drivers.build import make_device
from gateway.acquisition.line import Line
from gateway.model.sample import Sample
from tests.benches.buses import make_bus
from tests.benches.strangers.driven_loop import DrivenLoop, LoopClock, run_driven
from tests.benches.strangers.least_readings import IN_TIME, least_readings
from tests.benches.strangers.modbus_client import Wanted, plainly_read
from tests.benches.strangers.modbus_host import ForeignModbus
from tests.benches.strangers.modbus_nature import Memory, Nature, age_s, drawn, told
from tests.benches.strangers.polled import Polled

PERIODS = 50
WITHIN = 20
"""So many periods the gateway has to get to know a device."""
_OFTEN_LATE = 0.05
"""Share of the rounds in which the last unit's answers alone may take longer than a period, and delay the other one."""
_STEP_S = 0.02
"""Of the registers' time."""

_FUNCTIONS_AND_ADDRESSES = ((4, 0), (4, 200), (3, 0))


def blocks_of(nature: Nature) -> Sequence[tuple[int, int, int]]:
    """Function, address and channels of each."""
    places = _FUNCTIONS_AND_ADDRESSES[: nature.blocks]
    return [(f, a, 2 if nature.alike or i == 0 else 1) for i, (f, a) in enumerate(places)]


@cache
def profile_of(blocks: tuple[tuple[int, int, int], ...]) -> str:
    """The path of a profile with these blocks."""
    path = Path(tempfile.mkdtemp(prefix="strangers")) / "blocks.toml"
    text = 'protocol = "modbus"\ntitle = "some blocks"\nbuses = ["modbus_rtu", "modbus_tcp"]\nunit = "1"\n'
    for function, address, channels in blocks:
        text += f'[[block]]\nfunction = {function}\naddress = {address}\nchannels = {channels}\ntype = "uint16"\n'
    path.write_text(text)
    return str(path)


def memory_of(nature: Nature, unit: int, per_s: float = 100.0) -> Memory:
    """The registers of a unit. per_s: resolution of the time that they tell"""
    places = ((f, a + i) for f, a, channels in blocks_of(nature) for i in range(channels))
    return Memory(unit, {place: number for number, place in enumerate(places)}, per_s)


class Trial:
    """One seed."""

    def __init__(self, nature: Nature, seed: int) -> None:
        self.nature, self.seed = nature, seed
        self.units = range(1, nature.units + 1)
        self.lasts_s = PERIODS * nature.period_s
        self.ignores_numbers = nature.number != "right" and nature.in_order and bool(seed % 2)
        """Whether the gateway is told to, and the plain client does."""
        self.ours = Polled(self._wrong)
        self.said, self.notices = self.ours.said, self.ours.notices
        self.plain: list[dict[int, float]] = []

    def _host(self, loop: DrivenLoop) -> None:
        self._began_s = loop.time()
        memories = {unit: memory_of(self.nature, unit) for unit in self.units}
        loop.hosts["host"] = ForeignModbus(loop, self.nature, memories, random.Random(self.seed))

    def run(self) -> None:
        run_driven(self._gateway)
        run_driven(self._plain)

    async def _plain(self, loop: DrivenLoop) -> None:
        self._host(loop)
        asked: dict[Wanted, int] = {}
        for unit in self.units:
            number = 0
            for function, address, channels in blocks_of(self.nature):
                asked[unit, function, address, channels] = number
                number += channels
        self.plain = await plainly_read(
            loop, self.nature, list(asked), asked, self.lasts_s, ignores_numbers=self.ignores_numbers
        )

    async def _gateway(self, loop: DrivenLoop) -> None:
        self._host(loop)
        nature, clock = self.nature, LoopClock(loop)
        kind = "modbus_tcp" if nature.wire == "tcp" else "modbus_rtu_tcp"
        options = {"transaction_id": "ignore"} if self.ignores_numbers else {}
        bus = make_bus("bus", kind, {"host": "host", "port": 502, "timeout_s": nature.timeout_s, **options})
        profile = profile_of(tuple(blocks_of(nature)))
        drivers = []
        for unit in self.units:
            channels = {f"{unit}.{i}": i for i in range(sum(b[2] for b in blocks_of(nature)))}
            drivers.append(make_device(f"d{unit}", bus, profile, unit, channels, {}, clock))
        await self.ours.run(Line(bus, tuple(drivers), nature.period_s), clock, self.lasts_s)

    def _wrong(self, sample: Sample, at_s: float, last_s: float) -> str:
        unit, number, word = int(sample.channel[0]), int(sample.channel[2:]), int(sample.value)
        if told(word)[:2] != (unit, number):
            return f"shows register {told(word)[:2]}"
        old_s = age_s(word, self._began_s + at_s)
        return f"is {old_s:.2f} s old" if old_s > at_s - last_s + _STEP_S else ""

    def problems(self) -> Iterator[str]:
        """What is not as it must be."""
        yield from self.ours.wrong[:3]
        period_s = self.nature.period_s
        since_s = WITHIN * period_s
        rounds = self.plain[WITHIN * len(self.plain) // PERIODS :]
        for unit in self.units:
            theirs = [read.get(unit) for read in rounds]
            ours = self.ours.readings(f"{unit}.0", since_s)
            if ours < least_readings(theirs, period_s):
                had = [took_s for took_s in theirs if took_s is not None]
                yield f"unit {unit}: {ours} readings, a plain client has {len(had)}, each in {max(had):.2f} s or less"
        late = sum(took_s is not None and took_s > IN_TIME * period_s for took_s in theirs)  # of the last unit
        if (
            self.nature.units == 2
            and self.nature.only_last
            and self._is_of_a_unit
            and late <= _OFTEN_LATE * len(theirs)
        ):
            gaps = sorted(b - a for a, b in pairwise(s for s in self.ours.polled["1.0"] if s >= since_s))
            often_s = gaps[-len(gaps) // 10 - 1]
            if often_s > 1.2 * self.nature.period_s:
                yield f"unit 1 is polled after up to {gaps[-1]:.2f} s, often {often_s:.2f} s"

    @property
    def _is_of_a_unit(self) -> bool:
        """Whether its oddity is only the last unit's, whose answers fit into a period, so that the other one need not
        suffer."""
        n = self.nature
        if n.blocks * (n.took_s + n.jitter_s / 2 + n.rest_s) > n.period_s:
            return False
        connection = n.mute_s or n.lingers_s or n.closes_after or n.closes_idle_s or n.behind or n.restarts
        return not (connection or n.number != "right" or n.answers_as >= 0 or n.noise or n.twice or n.pieces_s)


def tried(seed: int) -> Trial:
    """The trial of that seed."""
    trial = Trial(drawn(random.Random(seed)), seed)
    trial.run()
    return trial
