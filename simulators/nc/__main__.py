"""A standalone emulated SINUMERIK, at real speed, for rehearsals: `python -m simulators.nc --port 4841`.

Prints the lines of a gateway's configuration that lead to it, then what the gateway does to it, until Ctrl-C. Anybody
on this computer may read and write it; no other computer can reach it.
"""

import argparse
import asyncio
import logging
import signal

from simulators.nc.alone import run_alone
from simulators.nc.cycle import CycleSettings


async def _until_interrupted(cycle: CycleSettings, warm_s: float, port: int) -> None:
    stop = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, stop.set)
    await run_alone(cycle, warm_s, port, lambda line: print(line, flush=True), stop)


def _positive(text: str) -> float:
    value = float(text)
    if not 0.0 < value < 1e6:
        raise argparse.ArgumentTypeError(f"{text}: expected more than 0 and less than a million")
    return value


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m simulators.nc", description=__doc__)
    parser.add_argument("--port", type=int, default=0, help="TCP port on this computer (a free one)")
    parser.add_argument("--cycle-s", type=_positive, default=120.0, help="duration of a probing cycle (120)")
    parser.add_argument("--warm-s", type=_positive, default=1800.0, help="time constant of the table's growth (1800)")
    parser.add_argument("--radius-mm", type=_positive, default=200.0, help="[probing] sphere_radius_mm (200)")
    parser.add_argument("--height-mm", type=float, default=80.0, help="[probing] sphere_height_mm (80)")
    chosen = parser.parse_args()
    if not 0 <= chosen.port <= 65535:
        parser.error(f"--port {chosen.port}: expected 0 to 65535")
    cycle = CycleSettings(
        radius_mm=chosen.radius_mm,
        height_mm=chosen.height_mm,
        duration_s=chosen.cycle_s,
        approach_s=chosen.cycle_s / 12.0,
    )
    logging.getLogger("asyncua").setLevel(logging.CRITICAL)  # a port that is taken, said below
    try:
        asyncio.run(_until_interrupted(cycle, chosen.warm_s, chosen.port))
    except OSError as error:
        parser.error(f"{error.strerror or error}: choose another --port, or none for a free one")


if __name__ == "__main__":
    main()
