"""Plays many faults at once, each on its own wire: the whole table in the time of a few rows."""

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path

from tests.benches.faults.actions import Do
from tests.benches.faults.plant import FaultyPlant

Play = Callable[[Path], Awaitable[None]]
"""Takes an empty folder; raises AssertionError or TimeoutError."""


async def done(action: Do, plant: FaultyPlant) -> None:
    """Call the action, and await it if it is asynchronous."""
    waiting = action(plant)
    if waiting is not None:
        await waiting


async def all_at_once(plays: Mapping[str, Play], folder: Path) -> None:
    """Play all of them, each on its own wire. An AssertionError names each play that failed, and why."""
    failed: list[str] = []

    async def one(name: str, play: Play) -> None:
        place = folder / name
        await asyncio.to_thread(place.mkdir)
        try:
            await play(place)
        except* (AssertionError, TimeoutError) as errors:  # in a group when the acquisition ran
            failed.append(f"{name}: {errors.exceptions}")

    async with asyncio.TaskGroup() as tasks:
        for name, play in plays.items():
            tasks.create_task(one(name, play), name=name)
    assert not failed, "\n".join(failed)
