"""Several sinks in order: an event that cannot be stored reaches no other sink."""

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from gateway.events import FrameMade, GatewayEvent, ProbingRequested, in_order
from gateway.storage import History, Store, StoreError
from tests.benches.kept_events import KeptEvents
from tests.benches.stepped_clock import SteppedClock
from tests.benches.telemetry_examples import FRAME


def test_a_request_is_on_the_disk_before_the_next_sink_gets_it(tmp_path: Path) -> None:
    path, seen = tmp_path / "gateway.sqlite", list[int | None]()

    def look(event: GatewayEvent) -> None:
        assert isinstance(event, ProbingRequested)
        with History(path) as history:
            seen.append(history.last_number())

    with Store(path, "boot", SteppedClock()) as store:
        take = in_order([store.record, look])
        for number in (41, 42):
            take(ProbingRequested(number))
    assert seen == [41, 42]


def test_a_number_that_cannot_be_stored_is_published_nowhere_and_the_rest_is(tmp_path: Path) -> None:
    path, kept = tmp_path / "gateway.sqlite", KeptEvents()
    with Store(path, "boot", SteppedClock(), commit_s=0.01, retry_s=0.05) as store:
        take = in_order([store.record, kept])
        with closing(sqlite3.connect(path, isolation_level=None)) as other:
            other.execute("BEGIN IMMEDIATE")  # another program locks it
            take(FrameMade(FRAME))
            with pytest.raises(StoreError, match="locked"):
                take(ProbingRequested(41))
            other.execute("ROLLBACK")
    assert len(kept.frames) == 1
    assert kept.of(ProbingRequested) == []
