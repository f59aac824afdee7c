"""`python -m tests.benches.live_machine FOLDER`: the bench's machine at the computer's own speed, with faults on
request.

Prints its TCP ports as one JSON line when it is ready, then `done` for each line on standard input, `begin FAULT` or
`end FAULT`, with a fault of tests/benches/faulty_machine.py. Ends when its standard input closes.
"""

import asyncio
import json
import sys
from datetime import UTC, datetime
from pathlib import Path

from simulators.clock import SharedClock
from tests.benches.faulty_machine import breakable_machine

SEED, HOURS = 1, 8.0


async def _run(folder: Path) -> None:
    clock = SharedClock(folder / "clock", epoch=datetime.now(UTC), owner=True)
    clock.start()
    try:
        async with breakable_machine(folder, clock, SEED, HOURS) as (_, ports, faults):
            print(json.dumps(ports), flush=True)
            while line := (await asyncio.to_thread(sys.stdin.readline)).strip():
                what, _, fault = line.partition(" ")
                await faults[fault][what == "end"]()
                print("done", flush=True)
    finally:
        clock.close()


if __name__ == "__main__":
    asyncio.run(_run(Path(sys.argv[1])))
