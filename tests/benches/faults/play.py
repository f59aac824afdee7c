"""Playing many faults at once, each on its own wire: the whole table in the time of a few rows."""

import asyncio
import time
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path

from tests.benches.faults.actions import Do
from tests.benches.faults.bench import Metronome
from tests.benches.faults.plants import TIMEOUT_S, Plant

ONE_AFTER_THE_OTHER_S = 0.037
"""Between the starts, lest all wires be busy at the same moment of each period."""
STARVED_S = TIMEOUT_S / 3
"""A computer that does not let a thread run for so long makes living devices late: what was seen then counts not."""
MOST_TRIES = 8

Play = Callable[[Path, Metronome], Awaitable[None]]
"""Takes an empty folder; raises AssertionError or TimeoutError."""


async def done(action: Do, plant: Plant) -> None:
    """Do it, and wait when it takes time."""
    waiting = action(plant)
    if waiting is not None:
        await waiting


async def all_at_once(plays: Mapping[str, Play], folder: Path) -> None:
    """Each on its own wire; one that failed while the computer was starved is played again.

    An AssertionError names the play.
    """
    with Metronome() as metronome:

        async def until_undisturbed(name: str, play: Play) -> None:
            for tries in range(1, MOST_TRIES + 1):
                begun = time.monotonic()
                place = folder / f"{name} {tries}"
                await asyncio.to_thread(place.mkdir)
                try:
                    await play(place, metronome)
                except* (AssertionError, TimeoutError) as errors:  # in a group when the acquisition ran
                    if tries == MOST_TRIES or metronome.lost_s(begun) < STARVED_S:
                        raise AssertionError(f"{name}: {errors.exceptions}") from errors
                else:
                    return

        async with asyncio.TaskGroup() as tasks:
            for name, play in plays.items():
                tasks.create_task(until_undisturbed(name, play), name=name)
                await asyncio.sleep(ONE_AFTER_THE_OTHER_S)
