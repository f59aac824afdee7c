"""Several sinks in order: what is stored first is published next, and what cannot be stored is not published."""

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


def test_nothing_is_published_that_cannot_be_stored(tmp_path: Path) -> None:
    kept = KeptEvents()

    def run() -> None:
        with Store(tmp_path / "gateway.sqlite", "boot", SteppedClock()) as store:
            take = in_order([store.record, kept])
            take(FrameMade(FRAME))
            store.record(FrameMade(FRAME))  # the same index twice: the database refuses
            store.flush()
            take(FrameMade(FRAME))

    with pytest.raises(StoreError, match="UNIQUE constraint failed"):
        run()
    assert len(kept.frames) == 1
