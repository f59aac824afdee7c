"""The command line as a user runs it: in a separate process, with the emulated devices inside the test."""

import asyncio
import os
import sys
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from pathlib import Path
from signal import SIGINT

LIMIT_S = 300.0


@dataclass(frozen=True, slots=True)
class Done:
    """What a command left."""

    code: int
    out: str
    err: str


async def talc_gateway(
    *arguments: str,
    answer: str = "",
    columns: int = 100,
    interrupt: Callable[[], Awaitable[object]] | None = None,
    folder: Path | None = None,
    together: bool = False,
) -> Done:
    """Run to its end, in `folder`. `answer` is typed at its questions; Ctrl-C comes when `interrupt` returns.

    together: errors stand in `out`, where they came
    """
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "gateway", *arguments),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.STDOUT if together else asyncio.subprocess.PIPE,
        cwd=folder,
        env={**os.environ, "COLUMNS": str(columns), "PYTHONWARNINGS": "error::ResourceWarning"},
    )
    try:
        async with asyncio.timeout(LIMIT_S):
            if interrupt is not None:
                await interrupt()
                process.send_signal(SIGINT)
            out, err = await process.communicate(answer.encode())
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
    return Done(process.returncode or 0, out.decode(), (err or b"").decode())
