"""When the storing thread wakes up: for rows, after they waited for others, and for its looks at the disk."""

import sqlite3
import time
from contextlib import closing
from pathlib import Path

import pytest

from drivers.base import Quality
from gateway.model.events import ReadingsTaken
from gateway.model.sample import Sample
from gateway.storage.store import Store
from tests.benches.simulated_time import steps_of_time
from tests.benches.stepped_clock import EPOCH, SteppedClock

pytestmark = pytest.mark.simulated_time
COMMIT_S, LOOK_S = 10.0, 10.0
REST_S = 1000.0
"""With nothing to store."""


def take(store: Store, sequence: int) -> None:
    store.record(ReadingsTaken([Sample("a", 20.0, "degC", Quality.GOOD, EPOCH, 0.0, sequence=sequence)]))


def test_with_nothing_to_store_it_wakes_up_only_for_its_looks(tmp_path: Path) -> None:
    with Store(tmp_path / "g.sqlite", "boot1", SteppedClock(), commit_s=COMMIT_S, look_s=LOOK_S) as store:
        store.flush()
        before = steps_of_time()
        time.sleep(REST_S)
        assert steps_of_time() - before <= REST_S / LOOK_S + 3  # this sleep, and twice what is too old


def test_after_a_rest_readings_wait_for_others_as_ever_and_no_longer_than_commit_s(tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    with Store(path, "boot1", SteppedClock(), commit_s=COMMIT_S) as store, closing(sqlite3.connect(path)) as other:
        take(store, 1)
        store.flush()
        time.sleep(REST_S)
        began_s = time.monotonic()
        for sequence in range(2, 12):
            take(store, sequence)
            assert other.execute("SELECT count(*) FROM reading").fetchone() == (1,), "not each in its own commit"
            time.sleep(0.9)
        while other.execute("SELECT count(*) FROM reading").fetchone() != (11,):
            assert time.monotonic() - began_s < COMMIT_S
            time.sleep(0.1)
