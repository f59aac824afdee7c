"""The gateway's end: starts a process for each computation, and takes its answer."""

import asyncio
import pickle
import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import ParamSpec, TypeVar

from drivers.error_words import in_words
from gateway.model.codes import NoticeCode
from gateway.model.text import Text

Arguments = ParamSpec("Arguments")
Returned = TypeVar("Returned")

WORK_LIMIT_S = 3600.0
"""Real seconds; the papers' particle swarm over weeks of data takes minutes on a small computer."""


@dataclass(frozen=True, slots=True)
class Bounds:
    """What a computation may use."""

    elapsed_s: float = WORK_LIMIT_S
    """Real seconds."""
    processor_s: float = 0.0
    """Of the processor, from the time at which the process knows its work; 0: as much as it takes."""
    more_bytes: int = 0
    """Of memory besides what the process has by then; 0: as much as it takes."""


class WorkError(Exception):
    """The process ended without an answer; the message says how."""


async def in_process(
    work: Callable[Arguments, Returned], *given: Arguments.args, **named: Arguments.kwargs
) -> Returned:
    """What `work`, a module's function, gives for these arguments. Cancelling ends the process.

    Raises WorkError: no process could be started, or the work raised, was killed, or took longer than an hour.
    """
    return await in_process_within(Bounds(elapsed_s=WORK_LIMIT_S), work, *given, **named)


async def in_process_within(
    bounds: Bounds, work: Callable[Arguments, Returned], *given: Arguments.args, **named: Arguments.kwargs
) -> Returned:
    """The same, within bounds; WorkError also if the work exceeds them."""
    try:
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "gateway.runtime.workers"),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            start_new_session=True,  # Ctrl-C goes to the gateway, which ends the work itself
        )
    except OSError as error:  # no memory or descriptor at this moment: not a fault in the gateway
        what = f"{error.filename}: " if error.filename else ""
        raise WorkError(Text(NoticeCode.WORK_NOT_STARTED, what=what, why=in_words(error))) from error
    if process.stdin is None or process.stdout is None or process.stderr is None:
        raise RuntimeError("the process has no pipes")
    try:
        async with asyncio.timeout(bounds.elapsed_s):
            with suppress(BrokenPipeError, ConnectionResetError):  # it died: its exit status gives the reason
                process.stdin.write(pickle.dumps((work, given, named, bounds.processor_s, bounds.more_bytes)))
                await process.stdin.drain()
            answer, complaint = await asyncio.gather(process.stdout.read(), process.stderr.read())
            status = await process.wait()
    except TimeoutError:
        raise WorkError(Text(NoticeCode.WORK_SLOW, limit_s=bounds.elapsed_s)) from None
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
        process.stdin.close()
    if status == -signal.SIGPROF:
        raise WorkError(Text(NoticeCode.WORK_SLOW, limit_s=bounds.processor_s))
    if status < 0:
        raise WorkError(Text(NoticeCode.WORK_KILLED, signal=signal.Signals(-status).name))
    if status > 0:
        lines = complaint.decode(errors="replace").strip().splitlines() or ["it left no message"]
        raise WorkError(Text(NoticeCode.WORK_EXITED, said=lines[-1], status=status))
    found: Returned = pickle.loads(answer)
    return found
