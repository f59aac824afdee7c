"""A short life of a gateway, and again with a fault at its n-th call that changes the disk, for each n.

The life: start on a new file, measure, learn, compensate, take snapshots, stop; start again, delete what is old, go on,
stop; start on a file that is said to be damaged, which is mended, go on, stop. The gateway is the whole service with
its store, the control is the emulated one in this process, and time is simulated; only the store's thread runs in real
time. A layer under the process (`failing_disk.cc`) counts the calls and refuses them.

A fault lasts until the gateway has gone on with it for two steps, or has refused to start, or has stopped; or it is a
single one. A gateway that refuses to start is always started again, as systemd would.

`python -m tests.benches.disk_calls` prints a table; `--step 20` takes each twentieth call only.
"""

import faulthandler
import json
import os
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path

import click

from gateway.service.memory import freeze_gc
from tests.benches.disk_faults import FAULTS, HANGS_ONCE, DiskFault, LifeVerdict
from tests.benches.disk_life import LIMIT_S, Life
from tests.benches.preloads import preload

ROOT = Path(__file__).parents[2]
_SOURCE = Path(__file__).with_name("failing_disk.cc")
_WORDS = {
    "w": "write", "t": "truncate", "s": "synchronise", "c": "create a file", "r": "rename", "l": "link", "u": "unlink"
}  # fmt: skip
_HANGS = "one hangs"


def lives(folder: Path) -> None:
    """As a program: each line `number of the fault or -1, call` on standard input starts a life; its verdict is JSON.

    Each life is a fork of this process, in which a whole life has passed already: it loads and compiles nothing more.
    """
    rehearsal = folder / "rehearsal"
    rehearsal.mkdir()
    Life(rehearsal, None, 0).live()
    freeze_gc()
    for number, line in enumerate(sys.stdin):
        which, at, hang_ms = map(int, line.split())
        read, write = os.pipe()
        pid = os.fork()
        if not pid:
            os.close(read)
            faulthandler.dump_traceback_later(LIMIT_S, exit=True)
            here = folder / f"{number} {which} {at}"
            here.mkdir()
            fault = (
                None if which < 0 else (*FAULTS, DiskFault("hangs", HANGS_ONCE, lasting=True, hang_ms=hang_ms))[which]
            )
            try:
                verdict = Life(here, fault, at).live()
            except BaseException as error:  # noqa: BLE001 - the parent reports it
                verdict = LifeVerdict(wrong=[f"the bench: {error!r}"])
            with os.fdopen(write, "w") as pipe:
                pipe.write(json.dumps(asdict(verdict)))
            os._exit(0)
        os.close(write)
        with os.fdopen(read) as pipe:
            text = pipe.read()
        os.waitpid(pid, 0)
        print(text or json.dumps(asdict(LifeVerdict(wrong=["the process has ended or hung"]))), flush=True)


class LivesProcess:
    """Starts lives quickly: everything is imported once, each life is a fork. As a context manager."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder.resolve()

    def __enter__(self) -> "LivesProcess":
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.benches.disk_calls", "--lives", str(self._folder)],
            cwd=ROOT,
            env={
                **os.environ,
                "OPENBLAS_NUM_THREADS": "1",
                "LD_PRELOAD": str(preload(_SOURCE)),
                "FAILING_DISK": str(self._folder),
            },
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        return self

    def __exit__(self, *_: object) -> None:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()

    def life(self, which: int = -1, at: int = 0, hang_ms: int = 0) -> LifeVerdict:
        """A life with the fault of this number (-1: none; after the last: one synchronisation hangs)."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(f"{which} {at} {hang_ms}\n")
        self._process.stdin.flush()
        line = self._process.stdout.readline()
        assert line, "the process with the lives has ended"
        return LifeVerdict(**json.loads(line))


def _row(name: str, verdicts: Sequence[LifeVerdict]) -> str:
    reached = [v for v in verdicts if v.refused]
    return (
        f"| {name} | {len(reached)} | {sum(v.refused for v in reached)} | {sum(v.not_started for v in reached)} "
        f"| {sum(v.unstored > 0 for v in reached)} | {sum(v.told_lost > 0 for v in reached)} "
        f"| {sum(v.states_seen > 0 for v in verdicts)} | {sum(bool(v.wrong) for v in verdicts)} |"
    )


@click.command()
@click.option("--step", default=1, show_default=True, help="Take only every nth call.")
@click.option("--hang-ms", default=300, show_default=True)
@click.option("--first", default=1, show_default=True, help="Number of the first call.")
@click.option("--only", type=click.Choice([*(fault.name for fault in FAULTS), _HANGS]), help="Only this fault.")
@click.option("--lives", "folder", type=click.Path(path_type=Path), hidden=True)
def main(step: int, hang_ms: int, first: int, only: str | None, folder: Path | None) -> None:
    """Let a gateway live once for each fault and each call, and print what became of it."""
    if folder is not None:
        lives(folder)
        return
    wrong = Counter[str]()
    with tempfile.TemporaryDirectory() as name, LivesProcess(Path(name)) as process:
        whole = process.life()
        kinds = ", ".join(f"{_WORDS[kind]} {count}" for kind, count in Counter(whole.calls).most_common())
        click.echo(f"{datetime.now(UTC):%Y-%m-%d}: {len(whole.calls)} calls: {kinds}")
        click.echo("\n".join(whole.wrong))
        click.echo(
            "| fault | lives | calls refused | starts refused | went on unstored | said what is lost "
            "| state of the offsets seen | wrong |"
        )
        for which, named in enumerate((*(fault.name for fault in FAULTS), _HANGS)):
            if only not in (None, named):
                continue
            verdicts = []
            for at in range(first, len(whole.calls) + 1, step):
                if which == len(FAULTS) and whole.calls[at - 1] != "s":
                    continue
                verdicts.append(process.life(which, at, hang_ms))
                for text in verdicts[-1].wrong:
                    wrong[text] += 1
                    if wrong[text] <= 3:
                        click.echo(f"{named}, call {at} ({whole.calls[at - 1]}): {text}", err=True)
            click.echo(_row(f"{named} {hang_ms} ms" if named == _HANGS else named, verdicts))
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
