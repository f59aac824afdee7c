"""Changes an OPC UA server's answers, by a seed, and asks the driver of a SINUMERIK nevertheless."""

import asyncio
import random
from collections.abc import AsyncIterator, Callable, Iterable, Iterator
from contextlib import asynccontextmanager, suppress
from typing import Any

from drivers.base import DriverError, SystemClock
from drivers.nc import WatchdogTerms
from drivers.sinumerik.control import Sinumerik
from drivers.sinumerik.settings import SinumerikSettings
from tests.benches.cut_wire import wire_to
from tests.benches.emulated_bench import sinumerik_bench

TIMEOUT_S = 0.2
"""A spoilt answer is often no answer at all, and each costs this long."""


@asynccontextmanager
async def _spoilt_wire() -> AsyncIterator[tuple[Any, str]]:
    async with sinumerik_bench() as bench, wire_to(bench.url) as (wire, joined):
        yield wire, joined


def changes(seed: int) -> Iterator[Callable[[bytes], bytes]]:
    """Single answers with bytes exchanged, cut, doubled, or lengths made huge or negative; the header often whole."""
    draw = random.Random(seed)
    while True:
        kind, from_start = draw.choice(("bytes", "ones", "cut", "double", "length")), draw.choice((0, 8, 24, 40))

        def change(data: bytes, kind: str = kind, first: int = from_start) -> bytes:
            if len(data) <= first + 4:
                return data
            spoilt, at = bytearray(data), draw.randrange(first, len(data) - 4)
            match kind:
                case "bytes":
                    for _ in range(draw.randint(1, 4)):
                        spoilt[draw.randrange(first, len(data))] = draw.randrange(256)
                case "ones":
                    spoilt[at : at + 4] = b"\xff\xff\xff\xff"
                case "length":
                    spoilt[at : at + 4] = draw.choice((0, 1, 2**31 - 1, 2**31, 70_000)).to_bytes(4, "little")
                case "cut":
                    del spoilt[at:]
                case "double":
                    spoilt += data
            return bytes(spoilt)

        yield change


async def _connected(nc: Sinumerik) -> None:
    """With a session that answers; on a busy computer an answer may take longer than the driver waits."""
    async with asyncio.timeout(60.0):
        while True:
            try:
                await nc.snapshot()
                return
            except DriverError:
                with suppress(DriverError):
                    await nc.connect()


async def ask_spoilt(seeds: Iterable[int], answers: int) -> int:
    """How many of the spoilt answers the driver refused. Anything but a DriverError ends the test."""
    refused = 0
    async with _spoilt_wire() as (wire, joined):
        nc = Sinumerik(
            SinumerikSettings(security="none", url=joined, timeout_s=TIMEOUT_S, subscribe_s=0.0), SystemClock()
        )
        for seed in seeds:
            spoilt = changes(seed)
            for number in range(answers):
                wire.spoil = None
                await _connected(nc)
                wire.spoil = next(spoilt)
                try:
                    match number % 6:
                        case 0:
                            await nc.read_compensation()
                        case 1:
                            await nc.probing_status(1)
                        case 2:
                            await nc.write_compensation((0.0, 0.0, 0.0))
                        case 3:
                            await nc.claim(7, WatchdogTerms(10.0, 1.0))
                        case 4:
                            await nc.heartbeat(7)
                        case _:
                            await nc.connect()
                except DriverError:
                    refused += 1
        wire.spoil = None
        await nc.close()
        await asyncio.sleep(0)
    return refused
