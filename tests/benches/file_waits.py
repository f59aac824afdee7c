"""Waits for files that a command writes."""

import asyncio
from pathlib import Path

from tests.benches.command import LIMIT_S, Done
from tests.benches.waits import until


async def appears(path: Path, playing: "asyncio.Task[Done]") -> None:
    """Wait until the file is there; the command that makes it must not have ended."""
    await until(lambda: playing.done() or path.exists(), LIMIT_S)
    assert not playing.done(), playing.result()


def text_of(file: Path) -> str:
    """What the file contains now."""
    return file.read_text(encoding="utf-8") if file.exists() else ""
