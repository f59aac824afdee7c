"""The command line as a user runs it: in a separate process, with the emulated devices inside the test.

A process takes a second to start, so a command that ends by itself runs in the test's process: `here`, with the devices
`beside` it.
"""

import asyncio
import os
import sys
from collections.abc import Awaitable, Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractAsyncContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from signal import SIGINT
from typing import TypeVar

from click.testing import CliRunner

from gateway.cli.main import main

LIMIT_S = 300.0
_COLUMNS = 100

Devices = TypeVar("Devices")


@dataclass(frozen=True, slots=True)
class Done:
    """The result of a command."""

    code: int
    out: str
    err: str
    together: str = ""
    """Both, in the order in which they came; empty for a command in a separate process."""


def here(*arguments: object, answer: str = "", columns: int = _COLUMNS) -> Done:
    """Run in this process to its own end. `answer` is typed at its questions. Raises what it does not catch."""
    done = CliRunner(env={"COLUMNS": str(columns)}).invoke(main, [*map(str, arguments)], input=answer)
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    return Done(done.exit_code, done.stdout, done.stderr, done.output)


@contextmanager
def beside(devices: AbstractAsyncContextManager[Devices]) -> Iterator[Devices]:
    """Emulated devices on the event loop of another thread: a command has this one to itself."""
    begun: Future[tuple[Devices, Callable[[], object]]] = Future()

    async def serve() -> None:
        loop, end = asyncio.get_running_loop(), asyncio.Event()
        async with devices as opened:
            begun.set_result((opened, lambda: loop.call_soon_threadsafe(end.set)))
            await end.wait()

    def run() -> None:
        try:
            asyncio.run(serve())
        except BaseException as error:
            if begun.done():
                raise
            begun.set_exception(error)

    with ThreadPoolExecutor(1) as thread:
        serving = thread.submit(run)
        opened, end = begun.result()
        try:
            yield opened
        finally:
            end()
            serving.result()


async def talc_gateway(
    *arguments: str,
    answer: str = "",
    interrupt: Callable[[], Awaitable[object]] | None = None,
    folder: Path | None = None,
) -> Done:
    """Run to its end, in `folder`. `answer` is typed at its questions; Ctrl-C comes when `interrupt` returns."""
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "gateway", *arguments),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        cwd=folder,
        env={**os.environ, "COLUMNS": str(_COLUMNS), "PYTHONWARNINGS": "error::ResourceWarning"},
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
    return Done(process.returncode or 0, out.decode(), err.decode())
