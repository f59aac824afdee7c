"""Everything that gateways stored is collected once and in order, whichever part was away or killed meanwhile."""

import errno
import os
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest
from pyarrow import dataset

from gateway.listeners.collect.folder import CollectError, SiteFolder
from gateway.listeners.collect.progress import CollectProgress
from gateway.storage.readings import Pruning, Retention
from gateway.storage.schema import connect
from tests.benches.stored_site import FOUND, StoredSite, catch_up, collector, expected, kept, rows, write
from tests.benches.waits import turns

DAY = 288


@pytest.mark.parametrize("away", [30, pytest.param(DAY, marks=pytest.mark.slow)])
def test_after_a_day_away_everything_arrives_once_in_order_and_the_others_are_not_held_up(
    away: int, stored_site: StoredSite, tmp_path: Path
) -> None:
    out = tmp_path / "site"
    with SiteFolder(out) as folder:
        collecting = collector(stored_site, folder, limit=20)
        write(stored_site, "mill", range(200, 205))
        write(stored_site, "lathe", range(1))
        catch_up(collecting)
        stored_site.away = {"mill"}
        write(stored_site, "mill", range(205, 205 + away), "boot-2")
        stored_site.away = set()
        for number in turns(10 * away):
            write(stored_site, "lathe", range(number, number + 1), f"boot-{number + 1}")
            collecting.turn(30.0 * number)
            assert kept(out, "lathe")["steps"] == list(range(number + 1))
            if len(kept(out)["readings"]) >= 2 * (5 + away):
                break
        assert number >= away / 10, "the backlog took many turns, and each had what the other machine had just stored"
        catch_up(collecting, 30.0 * number)
    assert kept(out) == expected(range(200, 205 + away))
    days = sorted(p.name for p in (out / "steps" / "machine=mill").iterdir())
    assert days[:2] == ["day=2026-03-02", "day=2026-03-03"]
    assert not any((out / "incoming" / "mill").iterdir())
    assert not (out / "gaps").exists()


def test_a_machine_that_is_renamed_goes_on_under_its_new_name_and_its_past_is_not_kept_twice(
    stored_site: StoredSite, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    out = tmp_path / "site"
    write(stored_site, "mill", range(5))
    with SiteFolder(out) as folder:
        catch_up(collector(stored_site, folder))
        stored_site.path("mill").rename(stored_site.path("mill_2"))
        write(stored_site, "mill_2", range(5, 8), "boot-2")
        write(stored_site, "lathe", range(2))
        catch_up(collector(stored_site, folder))
    assert kept(out) == expected(range(5))
    assert kept(out, "mill_2")["steps"] == [5, 6, 7]
    assert kept(out, "lathe") == expected(range(2)), "its store is another one"
    assert [r.message for r in caplog.records if "was mill until now" in r.message] != []


def test_rows_of_a_time_that_has_not_come_are_kept_and_it_is_said(
    stored_site: StoredSite, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """FOUND is 300 steps after the first; a right clock stores no later step."""
    write(stored_site, "mill", range(295, 300))
    write(stored_site, "lathe", range(330, 337))
    with SiteFolder(tmp_path / "site") as folder:
        catch_up(collector(stored_site, folder))
    assert kept(tmp_path / "site", "lathe")["steps"] == list(range(330, 337))
    assert ["lathe" in record.message for record in caplog.records if "ahead of this" in record.message] == [True]


def test_a_gateway_is_asked_again_when_it_is_time_and_not_before(stored_site: StoredSite, tmp_path: Path) -> None:
    write(stored_site, "mill", range(2))
    with SiteFolder(tmp_path / "site") as folder:
        collecting = collector(stored_site, folder)
        catch_up(collecting)
        stored_site.asked.clear()
        assert collecting.turn(29.0) == 30.0
        assert stored_site.asked == []
        assert collecting.turn(30.0) == 60.0
        assert stored_site.asked == ["mill"]
    assert kept(tmp_path / "site") == expected(range(2))


class Killed(BaseException):
    """A BaseException, which no handler for errors catches."""


def at_call(number: int, what: type[BaseException], syncs: Callable[[int], None]) -> Callable[[int], None]:
    """Make this call raise, counting the calls that synchronise with the disk."""
    calls = 0

    def sync(descriptor: int) -> None:
        nonlocal calls
        calls += 1
        if calls == number:
            raise what(f"call {number}")
        syncs(descriptor)

    return sync


@pytest.mark.slow
@pytest.mark.parametrize("every", [7, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.parametrize("what", [Killed, pytest.param(OSError, marks=pytest.mark.slow)])
def test_killed_or_failing_at_any_moment_it_loses_and_doubles_nothing(
    what: type[BaseException], every: int, stored_site: StoredSite, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    over_midnight = range(210, 220)
    write(stored_site, "mill", over_midnight)
    whole, syncs, broken = expected(over_midnight), os.fsync, 0
    while True:
        out = tmp_path / f"site-{broken}"
        with monkeypatch.context() as patched, SiteFolder(out) as folder:
            patched.setattr("os.fsync", at_call(broken + 1, what, syncs))
            first = collector(stored_site, folder, limit=15)
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
            folder.progress("mill")
            assert not any((out / "incoming").rglob("*.parquet")), f"left at call {broken + 1}"
            catch_up(collector(stored_site, folder, limit=15))
        assert kept(out) == whole, f"interrupted at call {broken + 1}"
        broken += every
    assert broken > 20


@pytest.mark.parametrize(
    ("number", "said"), [(errno.ENOSPC, "free some space"), (errno.EROFS, "see to its disk")], ids=["full", "read-only"]
)
def test_a_disk_that_takes_nothing_is_reported_with_what_to_do(
    number: int, said: str, stored_site: StoredSite, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def sync(descriptor: int) -> None:
        raise OSError(number, os.strerror(number), "part.parquet")

    write(stored_site, "mill", range(3))
    with SiteFolder(tmp_path / "site") as folder:
        collecting = collector(stored_site, folder)
        with monkeypatch.context() as patched:
            patched.setattr("os.fsync", sync)
            catch_up(collecting)
            assert collecting.machines["mill"].problem == (
                f"{tmp_path / 'site'}: cannot be written or read: {os.strerror(number)} (part.parquet); {said}. "
                "The gateways keep their rows meanwhile"
            )
        catch_up(collecting, 30.0)
    assert kept(tmp_path / "site") == expected(range(3))


def test_it_goes_on_after_gateways_were_killed_and_their_stores_put_back(
    stored_site: StoredSite, tmp_path: Path
) -> None:
    with SiteFolder(tmp_path / "site") as folder:
        collecting = collector(stored_site, folder, limit=7)
        for n in range(6):
            write(stored_site, "mill", range(5 * n, 5 * n + 5), f"boot-{n}")
            if n == 2:
                with (
                    closing(connect(stored_site.path("mill"))) as source,
                    closing(connect(tmp_path / "copy")) as target,
                ):
                    source.backup(target)
            if n == 3:
                catch_up(collecting, 30.0 * n)
                for ending in ("-wal", "-shm"):
                    Path(f"{stored_site.path('mill')}{ending}").unlink(missing_ok=True)
                (tmp_path / "copy").replace(stored_site.path("mill"))
            collecting.turn(30.0 * n)
        catch_up(collecting, 300.0)
    found = kept(tmp_path / "site")
    assert found["steps"] == list(range(30))
    assert found["events"] == expected(range(30))["events"]
    identities = [(row["epoch"], row["row"]) for row in rows(tmp_path / "site", "readings")]
    assert len(set(identities)) == len(identities) == 60


def test_a_database_that_is_moved_away_and_comes_back_is_not_collected_twice(
    stored_site: StoredSite, tmp_path: Path
) -> None:
    with SiteFolder(tmp_path / "site") as folder:
        collecting = collector(stored_site, folder)
        for n in range(3):
            write(stored_site, "mill", range(5 * n, 5 * n + 5), f"boot-{n}")
            catch_up(collecting, 30.0 * n)
        own, aside = stored_site.path("mill"), tmp_path / "aside"
        own.replace(aside)
        write(stored_site, "mill", range(100, 105))  # the path was wrong for an hour
        catch_up(collecting, 90.0)
        aside.replace(own)
        write(stored_site, "mill", range(15, 20), "boot-4")
        catch_up(collecting, 120.0)
    assert kept(tmp_path / "site")["steps"] == [*range(15), *range(100, 105), *range(15, 20)]


def test_the_ends_of_a_tables_last_hundred_epochs_are_remembered() -> None:
    progress = CollectProgress()
    for n in range(101):
        progress = progress.moved_on("events", f"boot-{n}", 5)
    assert [progress.last("events", f"boot-{n}") for n in (0, 1, 100)] == [None, 5, 5]


def prune(site: StoredSite, pruning: Pruning, ran_s: float) -> None:
    with closing(connect(site.path("mill"))) as connection, connection:
        pruning.prune(connection, ran_s)


def test_a_gap_is_kept_with_the_rows(stored_site: StoredSite, tmp_path: Path) -> None:
    write(stored_site, "mill", range(20))
    pruning = Pruning(Retention(samples_days=1.0), 0.0)
    prune(stored_site, pruning, 100.0)
    prune(stored_site, pruning, 3 * 86400.0)
    with SiteFolder(tmp_path / "site") as folder:
        catch_up(collector(stored_site, folder))
        catch_up(collector(stored_site, folder))
    found = kept(tmp_path / "site")
    assert found["readings"] == [("column", 20, 19.5)], "the newest stays"
    assert {name: found[name] for name in ("steps", "measurements", "events")} == {
        name: expected(range(20))[name] for name in ("steps", "measurements", "events")
    }
    gaps = rows(tmp_path / "site", "gaps")
    assert [(gap["time"], gap["table"], gap["after"]) for gap in gaps] == [
        (FOUND, "readings", None),
        (FOUND, "reasons", None),
    ]
    assert found["reasons"] == [10]
    assert [(m["channel"], m["mean"]) for m in rows(tmp_path / "site", "minutes")][:2] == [
        ("bed", 0.5),
        ("column", 0.5),
    ]


def test_what_is_deleted_after_it_was_collected_is_no_gap(
    stored_site: StoredSite, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    pruning = Pruning(Retention(samples_days=1.0), 0.0)
    with SiteFolder(tmp_path / "site") as folder:
        write(stored_site, "mill", range(20))
        catch_up(collector(stored_site, folder))
        prune(stored_site, pruning, 100.0)
        write(stored_site, "mill", range(20, 40), "boot-2")
        prune(stored_site, pruning, 3 * 86400.0)
        catch_up(collector(stored_site, folder))
    assert kept(tmp_path / "site") == expected(range(40))
    assert not (tmp_path / "site" / "gaps").exists()
    assert caplog.messages == []


def test_a_part_grows_until_it_is_large_enough(stored_site: StoredSite, tmp_path: Path) -> None:
    with SiteFolder(tmp_path / "site", part_rows=25) as folder:
        collecting = collector(stored_site, folder)
        for n in range(6):
            write(stored_site, "mill", range(5 * n, 5 * n + 5), f"boot-{n}")
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


def test_a_damaged_progress_is_named_and_not_overwritten(stored_site: StoredSite, tmp_path: Path) -> None:
    write(stored_site, "mill", range(3))
    write(stored_site, "lathe", range(3))
    file = tmp_path / "site" / "progress" / "mill.json"
    with SiteFolder(tmp_path / "site") as folder:
        file.write_text('{"batch":')
        collecting = collector(stored_site, folder)
        catch_up(collecting)
        assert f"{file}: " in collecting.machines["mill"].problem
    assert file.read_text() == '{"batch":'
    assert kept(tmp_path / "site", "lathe") == expected(range(3))
