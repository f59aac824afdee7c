"""Runs in the guest under a copy of the service's unit: does one kind of work, and reports as JSON what became of
it."""

import asyncio
import json
import subprocess
import sys
import time
from pathlib import Path

from gateway.runtime.workers.control_group import divide
from gateway.runtime.workers.process import WorkError, apart

LEARNING = 3
READY_S, LASTS_S = 30.0, 10.0
"""When the measurement begins, after every interpreter has started, and how long it lasts."""


def used_s(begin_s: float, end_s: float) -> float:
    """Processor time that this process got between two moments of the monotonic clock."""
    time.sleep(max(0.0, begin_s - time.monotonic()))
    began_s = time.process_time()
    while time.monotonic() < end_s:
        pass
    return time.process_time() - began_s


def taken() -> int:
    """Take memory until there is none."""
    kept = []
    while True:
        kept.append(b"\1" * 2**24)


async def share() -> dict[str, float | str]:
    """How much of the processor the gateway's process gets beside those that learn."""
    divided = divide()
    begin_s = time.monotonic() + READY_S
    learning = [asyncio.create_task(apart(used_s, begin_s, begin_s + LASTS_S)) for _ in range(LEARNING)]
    own_s = await asyncio.to_thread(used_s, begin_s, begin_s + LASTS_S)
    others_s = sum(await asyncio.gather(*learning))
    return {"share": own_s / (own_s + others_s), "divided": str(divided)}


def tasks() -> dict[str, float | str]:
    """How many tasks the unit may have."""
    held: list[subprocess.Popen[bytes]] = []
    group = Path("/proc/self/cgroup").read_text(encoding="ascii").strip().removeprefix("0::")
    try:
        while True:
            held.append(subprocess.Popen(["/bin/sleep", "600"]))
    except OSError as error:
        count = Path(f"/sys/fs/cgroup{group}/pids.current").read_text(encoding="ascii")
        return {"tasks": int(count), "error": error.strerror or ""}
    finally:
        for process in held:
            process.kill()


async def hog() -> dict[str, float | str]:
    """Work apart that takes all memory of the unit."""
    divide()
    try:
        await apart(taken)
    except WorkError as error:
        return {"error": str(error), "goes_on": 1}
    return {"error": "none", "goes_on": 0}


def main() -> None:
    works = {"share": share, "hog": hog}
    work = sys.argv[1]
    print(json.dumps(tasks() if work == "tasks" else asyncio.run(works[work]())), flush=True)


if __name__ == "__main__":
    main()
