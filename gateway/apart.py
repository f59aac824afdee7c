"""Runs long computations in a separate process, so that the buses keep their periods.

The process receives the work on standard input, answers on standard output, and frees its memory by ending. It runs at
a lower priority than the gateway, in a control group of lower weight where there is one (gateway.learning_group), and
ends at once when the gateway ends.
"""

import asyncio
import os
import pickle
import signal
import sys
import threading
import traceback
from collections.abc import Callable
from contextlib import suppress
from typing import ParamSpec, TypeVar

from gateway.learning_group import join_learning

Arguments = ParamSpec("Arguments")
Returned = TypeVar("Returned")

LIMIT_S = 3600.0
"""Real seconds; the papers' particle swarm over weeks of data takes minutes on a small computer."""
_NICENESS = 10
_STDIN, _STDOUT = 0, 1


class WorkError(Exception):
    """The process ended without an answer; the message says how."""


async def apart(work: Callable[Arguments, Returned], *given: Arguments.args, **named: Arguments.kwargs) -> Returned:
    """What `work`, a module's function, gives for these arguments. Cancelling ends the process.

    Raises WorkError: no process could be started, or the work raised, was killed, or took longer than an hour.
    """
    try:
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "gateway.apart"),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            start_new_session=True,  # Ctrl-C goes to the gateway, which ends the work itself
        )
    except OSError as error:  # no memory or descriptor at this moment: not a fault in the gateway
        raise WorkError(f"no process could be started: {error}") from error
    if process.stdin is None or process.stdout is None or process.stderr is None:
        raise RuntimeError("the process has no pipes")
    try:
        async with asyncio.timeout(LIMIT_S):
            with suppress(BrokenPipeError, ConnectionResetError):  # it died: its exit status gives the reason
                process.stdin.write(pickle.dumps((work, given, named)))
                await process.stdin.drain()
            answer, complaint = await asyncio.gather(process.stdout.read(), process.stderr.read())
            status = await process.wait()
    except TimeoutError:
        raise WorkError(f"it did not finish within {LIMIT_S:g} s") from None
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
        process.stdin.close()
    if status < 0:
        raise WorkError(f"its process was ended by {signal.Signals(-status).name}; out of memory?")
    if status > 0:
        lines = complaint.decode(errors="replace").strip().splitlines() or ["it left no message"]
        raise WorkError(f"{lines[-1]} (exit status {status})")
    found: Returned = pickle.loads(answer)
    return found


def main() -> int:
    """The process. Its exit status is 0 with an answer on standard output, or 1 with a traceback on standard error."""
    os.nice(_NICENESS)
    join_learning()
    answer = os.dup(_STDOUT)
    os.dup2(sys.stderr.fileno(), _STDOUT)  # what a library prints must not become part of the answer
    try:
        work, given, named = pickle.load(sys.stdin.buffer)
        threading.Thread(target=_end_with_the_gateway, daemon=True).start()
        found = pickle.dumps(work(*given, **named))
    except Exception:  # noqa: BLE001 - the gateway reports any error
        traceback.print_exc()
        return 1
    with os.fdopen(answer, "wb") as out:
        out.write(found)
    return 0


def _end_with_the_gateway() -> None:
    """The gateway keeps the other end of standard input open for as long as it wants the answer."""
    os.read(_STDIN, 1)
    os._exit(1)


if __name__ == "__main__":
    sys.exit(main())
