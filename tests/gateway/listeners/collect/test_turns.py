"""When the machines of a large site are asked."""

import threading
from pathlib import Path

import pytest

from gateway.listeners.collect.collector import Collector
from gateway.listeners.collect.database import SiteDatabase
from gateway.listeners.collect.folder import CollectError, SiteFolder
from gateway.telemetry.answers import StoredRows
from tests.benches.free_port import free_port
from tests.benches.manual_clock import ManualClock


class NothingNew:
    """Many gateways with nothing new."""

    def __init__(self, many: int) -> None:
        self.names, self.asked = [f"m{n:03d}" for n in range(many)], list[str]()

    def running(self) -> list[str]:
        return self.names

    def ask(self, machine: str, after: object, limit: int) -> StoredRows:
        self.asked.append(machine)
        return StoredRows({})


def test_the_turns_of_many_machines_are_spread_over_the_time_and_stay_so(tmp_path: Path) -> None:
    gateways, last_s, gaps_s, most = NothingNew(70), dict[str, float](), list[float](), 0
    with SiteFolder(tmp_path / "site") as folder:
        collecting = Collector(gateways, folder, every_s=30.0)
        now_s = 1000.25
        while now_s < 1300.0:
            due_s = collecting.turn(now_s)
            for name in gateways.asked:
                gaps_s += [now_s - last_s[name]] if name in last_s else []
                last_s[name] = now_s
            if now_s > 1000.25:
                most = max(most, len(gateways.asked))
            gateways.asked.clear()
            assert due_s > now_s
            now_s = due_s + 0.125  # a turn begins a little late
    assert len(last_s) == 70
    assert most == 3, "70 machines in 30 turns of a second"
    first, later = gaps_s[:70], gaps_s[70:]
    assert min(first) >= 14.5
    assert max(first) <= 45.5
    assert len(later) > 500
    assert set(later) == {30.0}


class StoppedAtTheEnd(threading.Event):
    """Notes how long the collector waits, and lets that time pass at once."""

    def __init__(self, clock: ManualClock) -> None:
        super().__init__()
        self.clock, self.waits_s = clock, list[float | None]()

    def wait(self, timeout: float | None = None) -> bool:
        self.waits_s.append(timeout)
        self.clock.now += timeout or 0.0
        return self.is_set()


def test_what_holds_up_all_machines_is_reported_when_it_begins_and_when_it_ends(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock, refused = ManualClock(), OSError("database: connection refused")
    turns = [refused, refused, OSError("database: it is full"), None, None, refused, None, refused, None, refused, None]
    stop, left = StoppedAtTheEnd(clock), iter(turns)
    monkeypatch.setattr("gateway.listeners.collect.collector.SystemClock", lambda: clock)

    class OftenAway(SiteFolder):
        """A place that is away in some turns; after the last one the collector is stopped."""

        def ready(self) -> None:
            if (away := next(left, stop)) is stop:
                stop.set()
            elif isinstance(away, OSError):
                raise away

    with OftenAway(tmp_path / "site") as kept:
        Collector(NothingNew(0), kept, every_s=30.0).run(stop)
    assert stop.waits_s == [30.0] * (len(turns) + 1), "also after a failure"
    assert [record.message for record in caplog.records if "gateway" not in record.message] == [
        "database: connection refused",
        "database: it is full",
        "collecting again",
        "database: connection refused",
        "collecting again",
        "database: connection refused",
        "collecting again",
        "database: connection refused; it is intermittent: reported again when it has been steady for 300 s",
    ]


def test_a_database_that_is_down_at_the_start_is_waited_for() -> None:
    away = SiteDatabase(f"postgresql://site@127.0.0.1:{free_port()}/site")
    with away as kept, pytest.raises(CollectError, match="Connection refused"):
        kept.ready()
