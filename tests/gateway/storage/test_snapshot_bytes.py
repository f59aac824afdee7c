"""A snapshot is stored piece by piece, and read back bit for bit."""

import hashlib
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gateway.config.file import parse
from gateway.control.restart.earlier import earlier_run
from gateway.storage.snapshot import Snapshot, decode_snapshot
from gateway.storage.store import Store
from talc.frame import Frame, Frames
from tests.benches.service_file import MACHINE, adam6015
from tests.benches.stepped_clock import SteppedClock

TEXT = MACHINE + adam6015("bed = 0, column = 1, ram = 2")
AT_ONCE = 65_536
"""Numbers that the gateway packs at once."""


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    with Store(tmp_path / "gateway.sqlite", "boot-1", SteppedClock()) as store:
        yield store


def snapshot(store: Store, folder: Path, numbers: int) -> Snapshot:
    """The snapshot of a learner whose features have this many numbers, many of them zero and some that look like
    zero."""
    controller = earlier_run(store, parse(TEXT, folder / "gateway.toml")).controller
    for k in range(3):
        controller.step(Frame(k, np.full(3, 20.0 + k), np.full(3, fill_value=True)))
    state = controller.state()
    assert state.course is not None
    draw = np.random.default_rng(numbers)
    values = np.where(draw.random(numbers) < 0.3, 0.0, draw.normal(0.0, 1e-3, numbers))
    values[::17], values[1::19], values[2::23] = -0.0, np.nan, 5e-324
    mixture = replace(state.course.learner.mixture, x=values.reshape(1, numbers))
    course = replace(state.course, learner=replace(state.course.learner, mixture=mixture))
    return Snapshot("marks", replace(state, strategy=course), None, {"bed": 1}, (None,) * 9)


@pytest.mark.parametrize("numbers", [1, 9, AT_ONCE - 1, AT_ONCE, AT_ONCE + 1, 2 * AT_ONCE + 13])
def test_what_is_stored_is_what_was_known(numbers: int, store: Store, tmp_path: Path) -> None:
    kept = snapshot(store, tmp_path, numbers)
    store.keep(kept)
    store.flush()
    with closing(sqlite3.connect(tmp_path / "gateway.sqlite")) as connection:
        ((k, stored),) = connection.execute("SELECT k, state FROM snapshot").fetchall()
    assert k == 2
    assert hashlib.sha256(stored[32:]).digest() == stored[:32]

    def frames(first_k: int, last_k: int) -> Frames:
        ks = np.arange(first_k, last_k + 1)
        inputs = np.repeat(20.0 + ks[:, None], 3, axis=1)
        valid = np.full(inputs.shape, fill_value=True)
        return Frames(ks, inputs, valid, np.full((len(ks), 9), np.nan))

    found = decode_snapshot(stored, frames).state
    assert found.course is not None
    assert kept.state.course is not None
    before, after = (state.course.learner.mixture.x for state in (kept.state, found) if state.course)
    assert before.tobytes() == after.tobytes()
    assert np.array_equal(found.inputs, kept.state.inputs)


def test_the_older_of_two_snapshots_is_replaced(store: Store, tmp_path: Path) -> None:
    kept = snapshot(store, tmp_path, 100)
    for k in (10, 20, 30):
        store.keep(replace(kept, state=replace(kept.state, last_k=k)))
        store.flush()
    with closing(sqlite3.connect(tmp_path / "gateway.sqlite")) as connection:
        assert sorted(k for (k,) in connection.execute("SELECT k FROM snapshot")) == [20, 30]
