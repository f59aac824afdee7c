"""Waits for files that a command writes."""

import asyncio
from collections.abc import Callable
from pathlib import Path

from tests.benches.command import Done


async def appears(path: Path, playing: "asyncio.Task[Done]") -> None:
    """Wait until the file is there; the command that makes it must not have ended."""
    while not await asyncio.to_thread(path.exists):
        assert not playing.done(), playing.result()
        await asyncio.sleep(0.02)


def text_of(file: Path) -> str:
    """What the file contains now."""
    return file.read_text(encoding="utf-8") if file.exists() else ""


async def until(seen: Callable[[], bool]) -> None:
    """Wait for something outside this process."""
    while not seen():
        await asyncio.sleep(0.02)
