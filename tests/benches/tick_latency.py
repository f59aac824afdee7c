"""Latency from a grid tick to a subscriber, while the gateway learns: `python -m tests.benches.tick_latency --seconds
120`.

`talc-gateway run` in a separate process, on the computer's clock, with grid steps of a second. Its machine is the
bench's, in another process, whose time passes 300 times as fast: each step has the heat and the probing cycle of five
minutes. The subscriber is this process. The latency of a step runs from the instant that the step's number says until
its decision has come here.

Two ways of learning, a row each: the learner, which measures and learns in every step that allows it; and the papers'
models, trained in another process. Both begin with a day in the store, so the sensor check learns too.
"""

import argparse
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import zenoh

from benchmarks.acquisition import LONG_TRAINING, want_training
from gateway.config.file import load
from gateway.telemetry.codec import decode
from gateway.telemetry.messages import DecisionMessage, EventMessage
from simulators.bench import gateway_toml
from simulators.clock import SharedClock
from talc.frame import EventKind
from tests.benches.free_port import free_port

STEP_S = 1.0
_FASTER = 300.0
_READY_S, _STOPPED_S = 60.0, 60.0
_PACE = {
    "step_s = 300.0": f"step_s = {STEP_S}",
    "period_s = 100.0": "period_s = 0.5",
    "period_s = 30.0": "period_s = 0.2",
    "lead_s = 180.0": "lead_s = 0.9",
    "poll_s = 10.0": "poll_s = 0.05",
    "timeout_s = 900.0": "timeout_s = 30.0",
    "stale_after_s = 900.0": "stale_after_s = 10.0",
}
"""From the bench's configuration, whose gateway runs in the machine's time, to one that runs in real time."""
WAYS = {
    "learner": """
[talc.learner]
policy = "fixed"
measurement_interval_steps = 1
shortest_interval_steps = 1
""",
    "models": LONG_TRAINING
    + """
[talc.control]
measurement_interval_steps = 1
no_good_measurements = 1
acl = "fixed"
acl_fixed_um = 0.01
acl_fixed_um_per_m = 0.01
""",
}
"""Talc's settings for each way of learning. No model meets these limits, so one training follows another."""
_SENSOR_CHECK = "[sensor_check]\nwindow_steps = 12\nlearn_steps = 288\n"


@dataclass(frozen=True, slots=True)
class TickRun:
    """What the subscriber received."""

    latencies_s: tuple[float, ...]
    """By step, in order."""
    missing: int
    """Steps between the first and the last whose decision did not come."""
    disordered: int
    """Decisions that came twice, or after that of a later step."""
    learnt: int
    """Measurements that were learnt from meanwhile."""
    trainings: int
    """Trainings in a process beside that were asked for meanwhile."""
    trained_share: float
    """Share of the time in which a training ran: on a fast computer a training ends long before the next one."""
    waited_s: float
    """How long threads of the gateway and the subscriber were ready while others had the cores; in sum."""

    def percentile_ms(self, share: float) -> float:
        return float(np.percentile(self.latencies_s, share)) * 1e3


@dataclass(slots=True)
class _HeardDecisions:
    """Decisions by their step, with their latency, and how often something was learnt and trained."""

    steps: list[int] = field(default_factory=list)
    latencies_s: list[float] = field(default_factory=list)
    learnt: int = 0
    trainings: int = 0
    first: threading.Event = field(default_factory=threading.Event)

    def take(self, sample: zenoh.Sample) -> None:
        now_s = time.time()
        message = decode(str(sample.key_expr).rpartition("/")[2], sample.payload.to_bytes())
        if isinstance(message, DecisionMessage):
            self.steps.append(message.k)
            self.latencies_s.append(now_s - message.k * STEP_S)
            self.first.set()
        elif isinstance(message, EventMessage):
            self.learnt += message.kind == EventKind.STATE_UPDATE
            self.trainings += message.kind == EventKind.TRAINING_WANTED


@contextmanager
def _machine(folder: Path) -> Iterator[dict[str, object]]:
    """The bench's machine, and its addresses."""
    epoch = datetime.now(UTC)
    words = ("simulators.bench", str(folder), epoch.isoformat(), str(_FASTER), "1", "200", "rests")
    with (
        closing(SharedClock(folder / "clock", epoch=epoch, speed=_FASTER, owner=True)) as clock,
        subprocess.Popen([sys.executable, "-m", *words], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process,
    ):
        assert process.stdout is not None
        assert process.stdin is not None
        addresses = json.loads(process.stdout.readline())
        clock.start()
        try:
            yield addresses
        finally:
            process.stdin.close()
            process.wait(_STOPPED_S)


def _listening(here: str) -> zenoh.Config:
    config = zenoh.Config()
    config.insert_json5("listen/endpoints", f'["{here}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    return config


def _configured(folder: Path, addresses: dict[str, object], here: str, talc: str) -> Path:
    places = {**addresses, "folder": folder, "zenoh_port": free_port(), "zenoh_connect": f'["{here}"]'}
    before, mark, _ = gateway_toml(places).partition("[talc]")
    assert mark
    for old, new in _PACE.items():
        assert old in before, f"{old} is not in the bench's configuration"
        before = before.replace(old, new)
    path = folder / "gateway.toml"
    path.write_text(before + talc + _SENSOR_CHECK, encoding="utf-8")
    return path


def _has_child(process: int) -> bool:
    for task in Path(f"/proc/{process}/task").iterdir():
        with suppress(FileNotFoundError, ProcessLookupError):  # the thread has ended meanwhile
            if (task / "children").read_text():
                return True
    return False


def _waited_s(process: int) -> float:
    """The waits of all present threads, since they began."""
    found = 0.0
    for task in Path(f"/proc/{process}/task").iterdir():
        with suppress(FileNotFoundError, ProcessLookupError):  # the thread has ended meanwhile
            found += int((task / "schedstat").read_text(encoding="ascii").split()[1]) / 1e9
    return found


def run_ticks(way: str, seconds: float) -> TickRun:
    """Run a gateway that learns in one of the ways, and hear its decisions for this long after the first."""
    heard, trained, here = _HeardDecisions(), list[bool](), f"tcp/127.0.0.1:{free_port()}"
    with TemporaryDirectory() as name, _machine(Path(name)) as addresses, zenoh.open(_listening(here)) as session:
        path = _configured(Path(name), addresses, here, WAYS[way])
        want_training(load(path))
        dry_run = (
            sys.executable,
            "-m",
            "gateway",
            "nc",
            "dry-run",
            str(path),
            "--output",
            str(Path(name, "dry-run.txt")),
        )
        subprocess.run(dry_run, stdout=subprocess.DEVNULL, check=True, timeout=_READY_S)  # else nothing is measured
        hearing = [session.declare_subscriber("talc/bench/*", heard.take)]
        gateway = subprocess.Popen([sys.executable, "-m", "gateway", "run", str(path)], stderr=subprocess.DEVNULL)
        try:
            if not heard.first.wait(_READY_S):
                raise RuntimeError("the gateway published no decision")
            both = (gateway.pid, os.getpid())
            before_s, until_s = sum(map(_waited_s, both)), time.monotonic() + seconds
            while time.monotonic() < until_s:
                trained.append(_has_child(gateway.pid))
                time.sleep(STEP_S / 20)
            waited_s = sum(map(_waited_s, both)) - before_s
        finally:
            for subscriber in hearing:
                subscriber.undeclare()
            gateway.terminate()
            gateway.wait(_STOPPED_S)
    steps, share = heard.steps, sum(trained) / max(1, len(trained))
    missing = max(steps) - min(steps) + 1 - len(set(steps))
    disordered = sum(later <= earlier for earlier, later in pairwise(steps))
    return TickRun(tuple(heard.latencies_s), missing, disordered, heard.learnt, heard.trainings, share, waited_s)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=120.0)
    seconds = parser.parse_args().seconds
    print(
        "| learns by | steps, missing, disordered | learnt from | trainings | process beside learnt | p50, p99, most |"
    )
    for way in WAYS:
        found = run_ticks(way, seconds)
        p50, p99, most = (found.percentile_ms(share) for share in (50, 99, 100))
        print(
            f"| {way} | {len(found.latencies_s)}, {found.missing}, {found.disordered} | {found.learnt} "
            f"| {found.trainings} | {found.trained_share:.0%} of the time | {p50:.0f}, {p99:.0f}, {most:.0f} ms |",
            flush=True,
        )


if __name__ == "__main__":
    main()
