"""Everything that gateways stored is collected once and in order, whoever was away or killed meanwhile."""

import errno
import os
from collections.abc import Callable, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from pyarrow import dataset

from gateway.collect import CollectError, SiteFolder
from gateway.collect.progress import CollectProgress
from gateway.storage import Retention
from gateway.storage.readings import Pruning
from gateway.storage.schema import connect
from gateway.telemetry import StoredColumn, StoredRows, StoredTable
from tests.benches.stored_site import FIRST_K, FOUND, StoredSite, catch_up, collector, write

DAY = 288


def rows(folder: Path, table: str, machine: str = "mill") -> list[dict[str, Any]]:
    """In the order in which they were kept."""
    place = folder / table / f"machine={machine}"
    files = sorted(place.rglob("*.parquet"))
    return [row for file in files for row in dataset.dataset(file).to_table().to_pylist()]


def kept(folder: Path, machine: str = "mill") -> dict[str, list[Any]]:
    """What tells the rows of each table apart."""
    return {
        "readings": [(r["channel"], r["sequence"], r["value"]) for r in rows(folder, "readings", machine)],
        "steps": [r["k"] - FIRST_K for r in rows(folder, "steps", machine)],
        "measurements": [r["number"] for r in rows(folder, "measurements", machine)],
        "events": [r["text"] for r in rows(folder, "events", machine)],
    }


def expected(steps: range) -> dict[str, list[Any]]:
    tens = [n for n in steps if n % 10 == 0]
    return {
        "readings": [(c, n + 1, n + 0.5) for n in steps for c in ("bed", "column")],
        "steps": list(steps),
        "measurements": tens,
        "events": [f"number {n}" for n in tens],
    }


@pytest.fixture
def site(tmp_path: Path) -> StoredSite:
    (tmp_path / "gateways").mkdir()
    return StoredSite(tmp_path / "gateways")


@pytest.mark.parametrize("away", [30, pytest.param(DAY, marks=pytest.mark.slow)])
def test_after_a_day_away_everything_arrives_once_in_order_and_the_others_are_not_held_up(
    away: int, site: StoredSite, tmp_path: Path
) -> None:
    out = tmp_path / "site"
    with SiteFolder(out) as folder:
        collecting = collector(site, folder, limit=20)
        write(site, "mill", range(200, 205))
        write(site, "lathe", range(1))
        catch_up(collecting)
        site.away = {"mill"}
        write(site, "mill", range(205, 205 + away), "boot-2")
        site.away = set()
        turns = 0
        while not turns or len(kept(out)["readings"]) < 2 * (5 + away):
            write(site, "lathe", range(turns + 1, turns + 2), f"boot-{turns + 2}")
            turns += 1
            collecting.turn(30.0 * turns)
            assert kept(out, "lathe")["steps"] == list(range(turns + 1))
        assert turns >= away / 10, "the backlog took many turns, and each had what the other machine had just stored"
        catch_up(collecting, 30.0 * turns)
    assert kept(out) == expected(range(200, 205 + away))
    days = sorted(p.name for p in (out / "steps" / "machine=mill").iterdir())
    assert days[:2] == ["day=2026-03-02", "day=2026-03-03"]
    assert not any((out / "incoming" / "mill").iterdir())
    assert not (out / "gaps").exists()


def test_a_gateway_is_asked_again_when_it_is_time_and_not_before(site: StoredSite, tmp_path: Path) -> None:
    write(site, "mill", range(2))
    with SiteFolder(tmp_path / "site") as folder:
        collecting = collector(site, folder)
        catch_up(collecting)
        site.asked.clear()
        assert collecting.turn(29.0) == 30.0
        assert site.asked == []
        assert collecting.turn(30.0) == 60.0
        assert site.asked == ["mill"]
    assert kept(tmp_path / "site") == expected(range(2))


class Killed(BaseException):
    """No handler for errors sees it."""


def at_call(number: int, what: type[BaseException], syncs: Callable[[int], None]) -> Callable[[int], None]:
    """Of what synchronises with the disk, this call raises."""
    calls = 0

    def sync(descriptor: int) -> None:
        nonlocal calls
        calls += 1
        if calls == number:
            raise what(f"call {number}")
        syncs(descriptor)

    return sync


@pytest.mark.parametrize("every", [7, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.parametrize("what", [Killed, OSError])
def test_killed_or_failing_at_any_moment_it_loses_and_doubles_nothing(
    what: type[BaseException], every: int, site: StoredSite, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    over_midnight = range(210, 220)
    write(site, "mill", over_midnight)
    whole, syncs, broken = expected(over_midnight), os.fsync, 0
    while True:
        out = tmp_path / f"site-{broken}"
        with monkeypatch.context() as patched, SiteFolder(out) as folder:
            patched.setattr("os.fsync", at_call(broken + 1, what, syncs))
            first = collector(site, folder, limit=15)
            try:
                catch_up(first)
            except Killed:
                pass
            else:
                if not first.machines["mill"].problem:
                    break
                catch_up(first, 30.0)  # the same one goes on
                assert kept(out) == whole
        with SiteFolder(out) as folder:
            catch_up(collector(site, folder, limit=15))
        assert kept(out) == whole, f"interrupted at call {broken + 1}"
        broken += every
    assert broken > 20


@pytest.mark.parametrize(
    ("number", "said"), [(errno.ENOSPC, "free some space"), (errno.EROFS, "see to its disk")], ids=["full", "read-only"]
)
def test_a_disk_that_takes_nothing_is_told_with_what_to_do(
    number: int, said: str, site: StoredSite, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def sync(descriptor: int) -> None:
        raise OSError(number, os.strerror(number), "part.parquet")

    write(site, "mill", range(3))
    with SiteFolder(tmp_path / "site") as folder:
        collecting = collector(site, folder)
        with monkeypatch.context() as patched:
            patched.setattr("os.fsync", sync)
            catch_up(collecting)
            assert collecting.machines["mill"].problem == (
                f"{tmp_path / 'site'}: cannot be written or read: {os.strerror(number)} (part.parquet); {said}. "
                "The gateways keep their rows meanwhile"
            )
        catch_up(collecting, 30.0)
    assert kept(tmp_path / "site") == expected(range(3))


def test_it_goes_on_after_gateways_were_killed_and_their_stores_put_back(site: StoredSite, tmp_path: Path) -> None:
    with SiteFolder(tmp_path / "site") as folder:
        collecting = collector(site, folder, limit=7)
        for n in range(6):
            write(site, "mill", range(5 * n, 5 * n + 5), f"boot-{n}")
            if n == 2:
                with closing(connect(site.path("mill"))) as source, closing(connect(tmp_path / "copy")) as target:
                    source.backup(target)
            if n == 3:
                catch_up(collecting, 30.0 * n)
                for ending in ("-wal", "-shm"):
                    Path(f"{site.path('mill')}{ending}").unlink(missing_ok=True)
                (tmp_path / "copy").replace(site.path("mill"))
            collecting.turn(30.0 * n)
        catch_up(collecting, 300.0)
    found = kept(tmp_path / "site")
    assert found["steps"] == list(range(30))
    assert found["events"] == expected(range(30))["events"]
    identities = [(row["epoch"], row["row"]) for row in rows(tmp_path / "site", "readings")]
    assert len(set(identities)) == len(identities) == 60


def test_a_database_that_is_moved_away_and_comes_back_is_not_collected_twice(site: StoredSite, tmp_path: Path) -> None:
    with SiteFolder(tmp_path / "site") as folder:
        collecting = collector(site, folder)
        for n in range(3):
            write(site, "mill", range(5 * n, 5 * n + 5), f"boot-{n}")
            catch_up(collecting, 30.0 * n)
        own, aside = site.path("mill"), tmp_path / "aside"
        own.replace(aside)
        write(site, "mill", range(100, 105))  # the path was wrong for an hour
        catch_up(collecting, 90.0)
        aside.replace(own)
        write(site, "mill", range(15, 20), "boot-4")
        catch_up(collecting, 120.0)
    assert kept(tmp_path / "site")["steps"] == [*range(15), *range(100, 105), *range(15, 20)]


def test_of_a_table_the_ends_of_the_last_hundred_epochs_are_remembered() -> None:
    progress = CollectProgress()
    for n in range(101):
        progress = progress.moved_on("events", f"boot-{n}", 5)
    assert [progress.last("events", f"boot-{n}") for n in (0, 1, 100)] == [None, 5, 5]


def test_rows_that_are_told_again_are_kept_once_and_an_empty_promise_of_more_is_not_asked_without_end(
    site: StoredSite, tmp_path: Path
) -> None:
    same = StoredRows({"events": StoredTable(E, 2, more=True, numbers=[1, 2], columns=(TIME,))})
    with SiteFolder(tmp_path / "site") as folder:
        collecting = collector(Liar(site.folder, {"lathe": same}), folder)
        assert catch_up(collecting) == 2
        catch_up(collecting, 30.0)
    assert [row["row"] for row in rows(tmp_path / "site", "events", "lathe")] == [1, 2]


def test_a_gap_is_kept_with_the_rows(site: StoredSite, tmp_path: Path) -> None:
    write(site, "mill", range(20))
    with closing(connect(site.path("mill"))) as connection, connection:
        pruning = Pruning(Retention(samples_days=1.0), 0.0)
        pruning.prune(connection, 100.0)
        pruning.prune(connection, 3 * 86400.0)
    with SiteFolder(tmp_path / "site") as folder:
        catch_up(collector(site, folder))
        catch_up(collector(site, folder))
    found = kept(tmp_path / "site")
    assert found["readings"] == [("column", 20, 19.5)], "the newest stays"
    assert {name: found[name] for name in ("steps", "measurements", "events")} == {
        name: expected(range(20))[name] for name in ("steps", "measurements", "events")
    }
    (gap,) = rows(tmp_path / "site", "gaps")
    assert (gap["time"], gap["table"], gap["after"]) == (FOUND, "readings", None)
    assert [(m["channel"], m["mean"]) for m in rows(tmp_path / "site", "minutes")][:2] == [
        ("bed", 0.5),
        ("column", 0.5),
    ]


class Liar(StoredSite):
    """Some of its gateways answer something else."""

    def __init__(self, folder: Path, answers: Mapping[str, StoredRows | Exception]) -> None:
        super().__init__(folder)
        self.answers: Mapping[str, StoredRows | Exception] = answers

    def running(self) -> list[str]:
        return sorted({*super().running(), *self.answers})

    def ask(self, machine: str, after: Mapping[str, tuple[str, int] | None], limit: int) -> StoredRows:
        answer = self.answers.get(machine)
        if isinstance(answer, Exception):
            raise answer
        return super().ask(machine, after, limit) if answer is None else answer


E = "e" * 32
TIME = StoredColumn("time", "time", [1.7e9, 1.7e9])
ONE = StoredColumn("time", "time", [1.7e9])


@pytest.mark.parametrize(
    ("table", "said"),
    [
        (StoredTable(E, 2, numbers=[2, 1], columns=(TIME,)), "rows 2 to 1 do not ascend"),
        (StoredTable(E, 2, numbers=[1, 1], columns=(TIME,)), "rows 1 to 1 do not ascend"),
        (StoredTable(E, 2, numbers=[1, 3], columns=(TIME,)), "rows 1 to 3 do not ascend up to 2"),
        (StoredTable(E, 2, numbers=[1], columns=(TIME,)), "column time: 2 values for 1 rows"),
        (StoredTable(E, 2, numbers=[1], columns=(StoredColumn("t", "text", [7], ("a",)),)), "column t: "),
        (StoredTable(E, 2, numbers=[1], columns=(StoredColumn("k", "whole", [1.5]), ONE)), "column k: "),
        (StoredTable(E, 2, numbers=[1], columns=(StoredColumn("k", "blob", [1]), ONE)), "kind 'blob' is not known"),
        (StoredTable(E, 2, numbers=[1], columns=(StoredColumn("time", "time", [1e300]),)), "column time: "),
        (StoredTable(E, 2, numbers=[1], columns=(StoredColumn("time", "time", [None]),)), "rows without a time"),
        (StoredTable(E, 2, numbers=[1], columns=(StoredColumn("k", "whole", [1]),)), "rows without a time"),
        (StoredTable(E, 2**70, numbers=[1], columns=(ONE,)), f"row {2**70}: no row has such a number"),
        (StoredTable(E, 2**70, numbers=[2**70], columns=(ONE,)), f"row {2**70}: no row has such a number"),
        (StoredTable(E, 1, numbers=[1], columns=(ONE,), thinned=2**70), f"row {2**70}: no row has such a number"),
        (StoredTable("a,b:3;limit=9", 1, numbers=[1], columns=(ONE,)), "epoch 'a,b:3;limit=9': expected 32"),
        (StoredTable("", 1, numbers=[1], columns=(ONE,)), "epoch '': expected 32 hexadecimal digits"),
        (
            StoredTable(E, 1, numbers=[1], columns=(ONE, *2 * [StoredColumn("a", "number", [1.0])])),
            "column a: is there",
        ),
        (
            StoredTable(E, 1, numbers=[1], columns=(ONE, StoredColumn("epoch", "number", [1.0]))),
            "column epoch: is there",
        ),
        (StoredTable(E, 1, numbers=[1], columns=(ONE, StoredColumn("day", "number", [1.0]))), "column day: is there"),
        (StoredTable(E, 1, numbers=[1], columns=(ONE, StoredColumn("t", "text", [0.5], ("a",)))), "column t: "),
        (StoredTable(more=True), "events: has no epoch, not even from the beginning"),
        (StoredTable(problem="events cannot be read: a page is damaged"), "events cannot be read"),
    ],
)
def test_an_answer_that_is_none_is_told_and_holds_up_no_other_machine(
    table: StoredTable, said: str, site: StoredSite, tmp_path: Path
) -> None:
    write(site, "mill", range(3))
    liar = Liar(site.folder, {"lathe": StoredRows({"events": table})})
    with SiteFolder(tmp_path / "site") as folder:
        collecting = collector(liar, folder)
        catch_up(collecting)
        assert said in collecting.machines["lathe"].problem
        assert collecting.machines["mill"].problem == ""
    assert kept(tmp_path / "site") == expected(range(3))
    assert rows(tmp_path / "site", "events", "lathe") == []


@pytest.mark.parametrize("name", ["..", ".", "a b", "ä", "../../etc", "x" * 65, "machine=mill", "", "mill\n"])
def test_a_name_that_means_something_in_a_path_is_refused(name: str, site: StoredSite, tmp_path: Path) -> None:
    write(site, "mill", range(3))
    answer = StoredRows({"events": StoredTable(E, 1, numbers=[1], columns=(ONE,))})
    with SiteFolder(tmp_path / "site") as folder:
        collecting = collector(Liar(site.folder, {name: answer}), folder)
        catch_up(collecting)
        assert "no gateway has such a name" in collecting.machines[name].problem
    places = {p.name for p in (tmp_path / "site").glob("*/machine=*")}
    assert places == {"machine=mill"}
    assert sorted(p.name for p in tmp_path.iterdir()) == ["gateways", "site"]


def test_no_answer_and_a_table_of_a_later_program_are_taken_as_they_are(site: StoredSite, tmp_path: Path) -> None:
    later = StoredRows({"spectra": StoredTable(E, 1, numbers=[1], columns=(ONE,))})
    liar = Liar(site.folder, {"lathe": OSError("no answer"), "saw": later})
    with SiteFolder(tmp_path / "site") as folder:
        collecting = collector(liar, folder)
        catch_up(collecting)
    assert {name: asked.problem for name, asked in collecting.machines.items()} == {"lathe": "no answer", "saw": ""}
    assert not (tmp_path / "site" / "spectra").exists()


def test_what_befalls_many_machines_is_told_in_one_line_when_it_begins_and_when_it_ends(
    site: StoredSite, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    liar = Liar(site.folder, {f"m{n}": OSError("no answer") for n in range(7)})
    with SiteFolder(tmp_path / "site") as folder:
        collecting = collector(liar, folder)
        catch_up(collecting)
        catch_up(collecting, 30.0)
        liar.answers = {f"m{n}": StoredRows({}) for n in range(7)}
        catch_up(collecting, 60.0)
        liar.answers = {}
        catch_up(collecting, 90.0)
    assert caplog.messages == [
        "m0, m1, m2, m3, m4 and 2 more: not collected: no answer",
        "m0, m1, m2, m3, m4 and 2 more: collected again",
        "no gateway is heard; trying again",
    ]


def test_a_part_grows_until_it_is_large_enough(site: StoredSite, tmp_path: Path) -> None:
    with SiteFolder(tmp_path / "site", part_rows=25) as folder:
        collecting = collector(site, folder)
        for n in range(6):
            write(site, "mill", range(5 * n, 5 * n + 5), f"boot-{n}")
            catch_up(collecting, 30.0 * n)
    files = sorted((tmp_path / "site" / "readings").rglob("*.parquet"))
    assert [(file.name, dataset.dataset(file).count_rows()) for file in files] == [
        ("part-00001.parquet", 20), ("part-00002.parquet", 20), ("part-00003.parquet", 20),
    ]  # fmt: skip
    assert kept(tmp_path / "site") == expected(range(30))


def test_a_second_collector_is_kept_off_the_folder(tmp_path: Path) -> None:
    one, two = SiteFolder(tmp_path / "site"), SiteFolder(tmp_path / "site")
    with one, pytest.raises(CollectError, match="another collector writes to this folder"):
        two.__enter__()
    with two:
        pass


def test_a_damaged_progress_is_named_and_not_overwritten(site: StoredSite, tmp_path: Path) -> None:
    write(site, "mill", range(3))
    write(site, "lathe", range(3))
    file = tmp_path / "site" / "progress" / "mill.json"
    with SiteFolder(tmp_path / "site") as folder:
        file.write_text('{"batch":')
        collecting = collector(site, folder)
        catch_up(collecting)
        assert f"{file}: " in collecting.machines["mill"].problem
    assert file.read_text() == '{"batch":'
    assert kept(tmp_path / "site", "lathe") == expected(range(3))
