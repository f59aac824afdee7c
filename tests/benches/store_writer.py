"""Writes steps to a store until it is killed; prints each index once it is committed. Run by test_store.py.

It is killed before the call that changes the disk whose number it is given, on the disk of failing_disk.py.
"""

import ctypes
import sys
from itertools import count
from pathlib import Path

import numpy as np

from drivers.base import Quality, SystemClock
from gateway.model.events import DecisionMade, FrameMade, ReadingsTaken
from gateway.model.sample import Sample
from gateway.storage.store import Store
from talc.frame import Decision, Frame, Phase

_KILLS = -3
"""The fault of failing_disk.cc that kills."""


def step(k: int) -> tuple[Frame, Decision]:
    """Numbers that follow from k alone."""
    inputs = np.random.default_rng(k).normal(20.0, 5.0, 36)
    nine = np.random.default_rng(-k % 2**32).normal(0.0, 10.0, 9)
    frame = Frame(k, inputs, inputs > 15.0)
    decision = Decision(k, Phase.CALIBRATION, nine, nine + 1.0, nine + 2.0, nine + 3.0, None, None, ())
    return frame, decision


def main(path: Path, first: int, killed_at: int) -> None:
    clock = SystemClock()
    ctypes.CDLL(None).fail_from(killed_at, _KILLS, 0)
    with Store(path, f"boot{first}", clock, commit_s=0.01) as store:
        store.begin("{}", "hash", "versions")
        for k in count(first):
            frame, decision = step(k)
            now = clock.utc()
            store.record(
                ReadingsTaken(
                    [Sample(f"c{i}", 20.0 + i, "degC", Quality.GOOD, now, 0.0, sequence=k) for i in range(30)]
                )
            )
            store.record(FrameMade(frame))
            store.record(DecisionMade(decision))
            store.flush()
            print(k, flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
