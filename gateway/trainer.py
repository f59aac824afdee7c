"""Training in a process of its own: it takes seconds of computing, and the buses must keep their periods meanwhile.

The process gets the job on its standard input, answers with the models on its standard output, and gives its memory
back by ending. It runs at a lower priority than the gateway and ends at once when the gateway is gone.
"""

import asyncio
import json
import os
import pickle
import signal
import sys
import threading
import traceback
from contextlib import suppress

from talc.frame import TrainingJob
from talc.models import ModelSet
from talc.names import THERMAL_ERRORS

_LIMIT_S = 3600.0
"""Real seconds; the papers' particle swarm over weeks of data takes minutes on a small computer."""
_NICENESS = 10
_STDIN, _STDOUT = 0, 1
_FAILED = "the training failed: "


class TrainingError(Exception):
    """The process ended without models; the message says how."""


async def train_apart(job: TrainingJob, *, limit_s: float = _LIMIT_S) -> ModelSet:
    """What `talc.training.train` gives for the job. Cancelling ends the process.

    Raises TrainingError: the training raised, was killed, or took longer than `limit_s`.
    """
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "gateway.trainer"),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        start_new_session=True,  # Ctrl-C is for the gateway, which ends the training itself
    )
    if process.stdin is None or process.stdout is None or process.stderr is None:
        raise RuntimeError("the training's process has no pipes")
    try:
        async with asyncio.timeout(limit_s):
            with suppress(BrokenPipeError, ConnectionResetError):  # it died: its exit status says more
                process.stdin.write(pickle.dumps(job))
                await process.stdin.drain()
            answer, complaint = await asyncio.gather(process.stdout.read(), process.stderr.read())
            status = await process.wait()
    except TimeoutError:
        raise TrainingError(f"it did not finish within {limit_s:g} s") from None
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
        process.stdin.close()
    if status < 0:
        raise TrainingError(f"its process was ended by {signal.Signals(-status).name}; out of memory?")
    if status > 0:
        lines = complaint.decode(errors="replace").strip().splitlines() or ["it left no message"]
        raise TrainingError(f"{lines[-1]} (exit status {status})")
    return ModelSet.from_dict(json.loads(answer))


def failed(job: TrainingJob, error: Exception) -> ModelSet:
    """What is adopted instead of the models of a training that failed: none, so that the former ones stay."""
    note = f"{_FAILED}{error}; the models stay as they were"
    nothing = (None,) * len(THERMAL_ERRORS)
    return ModelSet(k=job.k, why=job.why.value, input_names=job.input_names, models=nothing, notes=(note,))


def has_failed(models: ModelSet) -> bool:
    """Whether these are not a training's answer but stand for one that failed."""
    return any(note.startswith(_FAILED) for note in models.notes)


def main() -> int:
    """The process. Its exit status is 0 with models on the standard output, 1 with a traceback on the other."""
    os.nice(_NICENESS)
    answer = os.dup(_STDOUT)
    os.dup2(sys.stderr.fileno(), _STDOUT)  # what a library prints is no model
    job = pickle.load(sys.stdin.buffer)
    threading.Thread(target=_end_with_the_gateway, daemon=True).start()
    try:
        from talc.training import train

        models = train(job)
    except Exception:  # noqa: BLE001 - whatever it was, the gateway reports it
        traceback.print_exc()
        return 1
    with os.fdopen(answer, "wb") as out:
        out.write(json.dumps(models.to_dict()).encode())
    return 0


def _end_with_the_gateway() -> None:
    """The gateway holds the other end of our standard input open for as long as it wants models."""
    os.read(_STDIN, 1)
    os._exit(1)


if __name__ == "__main__":
    sys.exit(main())
