"""A store in a separate process, on a disk that the test can make fail.

As a program it is that process: each line of its input is a command, and each answer is a line of JSON.
"""

import ctypes
import errno
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from drivers.base import Quality, SystemClock
from gateway.model.events import DecisionMade, FrameMade, ReadingsTaken
from gateway.model.sample import Sample
from gateway.storage.faults import StoreError
from gateway.storage.store import Store
from tests.benches.preloads import preload
from tests.benches.store_writer import step

ROOT = Path(__file__).parents[2]
_SOURCE = Path(__file__).with_suffix(".cc")
HANGS = -1
FAULTS = {"ok": 0, "ENOSPC": errno.ENOSPC, "EIO": errno.EIO, "EROFS": errno.EROFS, "hangs": HANGS}


class StoreProcess:
    """The store's process."""

    def __init__(self, process: "subprocess.Popen[str]") -> None:
        self._process = process

    def ask(self, command: str) -> Any:
        """Its answer: to `fault NAME [synchronise]`, `step K`, `health`, `flush` or `close`."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(command + "\n")
        self._process.stdin.flush()
        line = self._process.stdout.readline()
        assert line, "the process with the store has ended"
        return json.loads(line)

    def ended(self, limit_s: float = 60.0) -> int:
        """The exit status of the process, which ends by itself after `close`."""
        return self._process.wait(limit_s)

    def until(self, failing: bool, limit_s: float = 120.0) -> Any:
        """The health when storing fails, or works again with nothing waiting."""
        end = time.monotonic() + limit_s
        while time.monotonic() < end:
            health = self.ask("health")
            if bool(health["problem"]) is failing and (failing or not health["waiting"]):
                return health
            time.sleep(0.02)
        raise AssertionError(f"after {limit_s} s: {health}")


def on_failing_disk(
    folder: Path, hanging: Path | None = None, *, reads: bool = False, stopped: bool = False
) -> dict[str, str]:
    """The environment of a process for which what is below this folder is on the disk that can fail.

    hanging: while this file, on another disk, is there, the disk hangs
    reads: opening and reading hang, too
    stopped: the process gets SIGTERM when it begins to wait
    """
    return {
        **os.environ,
        "OPENBLAS_NUM_THREADS": "1",
        "LD_PRELOAD": str(preload(_SOURCE)),
        "FAILING_DISK": str(folder.resolve()),
        **({} if hanging is None else {"HANGING_DISK": str(hanging.resolve())}),
        **({"HANGING_READS": "1"} if reads else {}),
        **({"STOPPED_WHILE_HANGING": "1"} if stopped else {}),
    }


@contextmanager
def store_process(path: Path, hangs_after_s: float = 30.0, silent_s: float = 30.0) -> Iterator[StoreProcess]:
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.benches.failing_disk", str(path), str(hangs_after_s), str(silent_s)],
        cwd=ROOT,
        env=on_failing_disk(path.parent),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    with process:
        try:
            yield StoreProcess(process)
        finally:
            process.kill()


def _answer(store: Store, disk: ctypes.CDLL, command: str) -> object:
    match command.split():
        case ["fault", name]:
            disk.set_disk_fault(FAULTS[name], 0)
            return None
        case ["fault", name, "synchronise"]:
            disk.set_disk_fault(FAULTS[name], ord("s"))
            return None
        case ["step", k]:
            began = time.monotonic()
            frame, decision = step(int(k))
            now = SystemClock().utc()
            store.record(ReadingsTaken([Sample("a", 20.0, "degC", Quality.GOOD, now, 0.0, sequence=int(k))]))
            store.record(FrameMade(frame))
            store.record(DecisionMade(decision))
            return time.monotonic() - began
        case ["health"]:
            return asdict(store.health) | {"faults": disk.disk_faults()}
        case ["flush"]:
            try:
                store.flush()
            except StoreError as error:
                return str(error)
            return ""
        case _:
            raise ValueError(command)


def main(path: Path, hangs_after_s: float, silent_s: float) -> None:
    disk = ctypes.CDLL(None)
    store = Store(
        path, "boot", SystemClock(), commit_s=0.01, retry_s=0.1, hangs_after_s=hangs_after_s, silent_s=silent_s
    )
    ended: object = ""
    with suppress_to(store) as outcome:
        for line in sys.stdin:
            if line.strip() == "close":
                break
            print(json.dumps(_answer(store, disk, line)), flush=True)
    ended = outcome[0] if outcome else ""
    print(json.dumps(ended), flush=True)


@contextmanager
def suppress_to(store: Store) -> Iterator[list[str]]:
    """The store's context; what its end raises becomes a text."""
    outcome: list[str] = []
    try:
        with store:
            yield outcome
    except StoreError as error:
        outcome.append(str(error))


if __name__ == "__main__":
    main(Path(sys.argv[1]), float(sys.argv[2]), float(sys.argv[3]))
