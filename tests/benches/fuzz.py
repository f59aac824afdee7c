"""Feeds random data to everything that comes in from outside: `python -m tests.benches.fuzz --seconds 60`.

Each surface gets a budget of processor time. An example that raises anything but its surface's own error is printed
with its seed, and the first time with its traceback.
"""

import asyncio
import logging
import random
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from contextlib import AsyncExitStack
from functools import partial
from pathlib import Path

import click

from tests.benches.fuzzed_files import FILES, Example
from tests.benches.fuzzed_messages import MESSAGES
from tests.benches.rigs import RIGS
from tests.benches.simulated_time import simulated_time
from tests.benches.spoilt_agent import ask_spoilt_agent
from tests.benches.spoilt_answers import read_spoilt
from tests.benches.spoilt_opcua import ask_spoilt

_WIRES = {
    "modbus": ("m7015", "adam6015", "wago464", "pta8d08", "pta8d08-device-server", "voltage"),
    "canopen": ("cia404-jumo", "cia404-sync", "cia404-timer"),
    "can": ("can_dbc",),
    "micro_epsilon": ("me_rs485", "me_ethernet"),
}
_ROUNDS, _ANSWERS = 10, 50


def _wire(rigs: Sequence[str], draw: random.Random, _: Path) -> None:
    async def read() -> None:
        async with AsyncExitStack() as stack:
            await read_spoilt(await RIGS[draw.choice(rigs)](stack), [draw.randrange(2**31) for _ in range(8)])

    with simulated_time():
        asyncio.run(read())


def _opcua(draw: random.Random, _: Path) -> None:
    with simulated_time():
        asyncio.run(_asked(draw))


async def _asked(draw: random.Random) -> None:
    await ask_spoilt([draw.randrange(2**31)], _ANSWERS)


def _agent(draw: random.Random, folder: Path) -> None:
    with simulated_time():
        asyncio.run(ask_spoilt_agent(folder, draw, _ROUNDS))


SURFACES: Mapping[str, Example] = {
    "opcua": _opcua,
    "agent": _agent,
    **{name: partial(_wire, rigs) for name, rigs in _WIRES.items()},
    **FILES,
    **MESSAGES,
}


def fuzzed(name: str, seconds: float, most: int | None, seed: int, say: Callable[[str], None]) -> bool:
    """Whether all examples of a surface ended well. most: the number of examples, however long they take."""
    wrong, examples, end_s = dict[str, list[int]](), 0, time.process_time() + seconds
    with tempfile.TemporaryDirectory() as outer:
        folder = Path(outer) / "here"
        folder.mkdir()
        while time.process_time() < end_s if most is None else examples < most:
            number = seed + examples
            examples += 1
            try:
                SURFACES[name](random.Random(number), folder)
            except Exception as error:  # noqa: BLE001 - that is what is looked for
                where = traceback.extract_tb(error.__traceback__)[-1]
                kind = f"{type(error).__name__} in {Path(where.filename).name}:{where.lineno}"
                if kind not in wrong:
                    say("".join(traceback.format_exception(error)))
                wrong.setdefault(kind, []).append(number)
    say(f"{name:<16}{examples:>9} examples{sum(map(len, wrong.values())):>6} wrong")
    for kind, seeds in wrong.items():
        say(f"  {kind}: seeds {', '.join(map(str, seeds[:5]))}{' ...' if len(seeds) > 5 else ''}")
    return not wrong


@click.command()
@click.argument("surfaces", nargs=-1, type=click.Choice(list(SURFACES)))
@click.option("--seconds", default=10.0, show_default=True, help="Processor time of each surface.")
@click.option(
    "--examples", type=click.IntRange(min=1), help="Try this many of each surface instead; one of opcua has 50 answers."
)
@click.option("--seed", default=0, show_default=True)
def main(surfaces: Sequence[str], seconds: float, examples: int | None, seed: int) -> None:
    """Try SURFACES, or all of them. Exit code 1: something raised what it should not."""
    logging.disable(logging.CRITICAL)
    well = [fuzzed(name, seconds, examples, seed, click.echo) for name in surfaces or SURFACES]
    sys.exit(0 if all(well) else 1)


if __name__ == "__main__":
    main()
