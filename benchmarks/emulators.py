"""`python -m benchmarks.emulators`: 500 channels on 20 Modbus buses in a separate process.

Prints one JSON line, the pseudo-terminals and the ports, and ends when its standard input closes.
"""

import asyncio
import json
import math
import sys
import time
from collections.abc import Callable

from simulators.devices import M7015, Adam6015, RtuLine, TcpHost

LINES, HOSTS, UNITS, CHANNELS = 10, 10, 5, 5
"""Serial lines and TCP hosts; units on each; channels used of each unit."""


def _slow_wave(phase: float, inputs: int) -> Callable[[], list[float]]:
    return lambda: [22.0 + 3.0 * math.sin(time.monotonic() / 600.0 + phase + i) for i in range(inputs)]


async def _serve() -> None:
    stop = asyncio.Event()
    asyncio.get_running_loop().add_reader(sys.stdin.fileno(), stop.set)
    lines = [RtuLine({u: M7015(_slow_wave(0.1 * n + u, 6)) for u in range(1, UNITS + 1)}) for n in range(LINES)]
    hosts = [TcpHost({u: Adam6015(_slow_wave(0.3 * n + u, 7)) for u in range(1, UNITS + 1)}) for n in range(HOSTS)]
    where = {"lines": [await line.start() for line in lines], "hosts": [await host.start() for host in hosts]}
    print(json.dumps(where), flush=True)
    await stop.wait()
    for line in lines:
        await line.stop()
    for host in hosts:
        await host.stop()


if __name__ == "__main__":
    asyncio.run(_serve())
