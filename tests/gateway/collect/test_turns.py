"""When the machines of a large site are asked."""

from pathlib import Path

from gateway.collect import Collector, SiteFolder
from gateway.telemetry import StoredRows


class NothingNew:
    """Many gateways that have nothing to tell."""

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
