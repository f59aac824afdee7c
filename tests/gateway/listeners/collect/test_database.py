"""A site in PostgreSQL has what its folder has, row by row, whatever is killed meanwhile. The server is Debian's."""

from contextlib import closing, suppress
from itertools import count
from pathlib import Path
from typing import Any

import psycopg
import pytest
from pyarrow import dataset

from gateway.listeners.collect.collector import Collector
from gateway.listeners.collect.database import SiteDatabase
from gateway.listeners.collect.folder import CollectError, SiteFolder
from gateway.storage.readings import Pruning, Retention
from gateway.storage.schema import connect
from gateway.telemetry.answers import StoredColumn, StoredRows, StoredTable
from tests.benches.plant_authority import PlantAuthority
from tests.benches.postgres import Postgres
from tests.benches.stored_site import FIRST_K, StoredSite, catch_up, collector, write

pytestmark = pytest.mark.peer
E = "e" * 32
_databases = count()


@pytest.fixture
def database(server: Postgres) -> str:
    """The name of a new database."""
    name = f"site{next(_databases)}"
    server.created(name)
    return name


def problems(collecting: Collector) -> dict[str, str]:
    return {name: asked.problem for name, asked in collecting.machines.items() if asked.problem}


def in_database(server: Postgres, database: str, table: str) -> list[dict[str, Any]]:
    """Rows without their empty columns, in the order of their numbers."""
    found = server.query(database, f'SELECT * FROM talc."{table}"')
    rows = [{name: value for name, value in row.items() if value is not None} for row in found]
    return sorted(rows, key=lambda row: (row["machine"], row["epoch"], row.get("row", 0)))


def in_folder(folder: Path, table: str) -> list[dict[str, Any]]:
    files = sorted((folder / table).rglob("*.parquet"))
    rows = [
        {"machine": file.parents[1].name.removeprefix("machine="), **row}
        for file in files
        for row in dataset.dataset(file).to_table().to_pylist()
    ]
    kept = [{name: value for name, value in row.items() if value is not None} for row in rows]
    return sorted(kept, key=lambda row: (row["machine"], row["epoch"], row.get("row", 0)))


def steps_of(server: Postgres, database: str) -> list[int]:
    return [row["k"] - FIRST_K for row in server.query(database, "SELECT k FROM talc.steps ORDER BY k")]


def test_rows_and_columns_are_those_of_the_folder(
    server: Postgres, database: str, stored_site: StoredSite, tmp_path: Path
) -> None:
    write(stored_site, "mill", range(20))
    with closing(connect(stored_site.path("mill"))) as connection, connection:
        pruning = Pruning(Retention(samples_days=1.0), 0.0)
        pruning.prune(connection, 100.0)
        pruning.prune(connection, 3 * 86400.0)
    write(stored_site, "lathe", range(200, 230))
    with SiteFolder(tmp_path / "site") as folder, kept_in(server.url(database)) as kept:
        for place in (folder, kept):
            collecting = collector(stored_site, place, limit=7)
            catch_up(collecting)
            assert problems(collecting) == {}
    tables = {row["tablename"] for row in server.query(database, "SELECT * FROM pg_tables WHERE schemaname = 'talc'")}
    assert tables == {path.name for path in (tmp_path / "site").iterdir()} - {"incoming"}
    filled = sorted(tables - {"progress"})
    assert set(filled) >= {"readings", "minutes", "steps", "measurements", "events", "gaps"}
    for table in filled:
        found = in_database(server, database, table)
        assert found == in_folder(tmp_path / "site", table)
        assert found, table


def kept_in(url: str) -> SiteDatabase:
    """Wait: a busy computer may take its time to notice that the previous collector has ended."""
    return SiteDatabase(url, lock_wait_s=600.0)


class CollectorKilled(BaseException):
    """A BaseException, which no handler for errors catches."""


class DatabaseInterrupted:
    """Kills the collector, or its connection, at one of its calls to the database.

    Commits are counted twice, because the connection may break before or after them.
    """

    def __init__(self, looking: "psycopg.Connection[Any]", at: int, what: str, patch: pytest.MonkeyPatch) -> None:
        self.happened, self._looking, self._at, self._what, self._calls = False, looking, at, what, 0
        execute, commit = psycopg.Connection.execute, psycopg.Connection.commit

        def executed(connection: Any, *words: Any, **more: Any) -> Any:
            self.call(connection)
            return execute(connection, *words, **more)

        def committed(connection: Any) -> None:
            self.call(connection)
            commit(connection)
            self.call(connection)

        patch.setattr(psycopg.Connection, "execute", executed)
        patch.setattr(psycopg.Connection, "commit", committed)

    def call(self, connection: "psycopg.Connection[Any]") -> None:
        if connection.info.parameter_status("application_name") != "talc-gateway collect":
            return
        self._calls += 1
        if self._calls != self._at:
            return
        self.happened = True
        if self._what == "collector":
            raise CollectorKilled
        pid = connection.info.backend_pid
        self._looking.execute("SELECT pg_terminate_backend(%s, 600000)", (pid,))
        raise psycopg.OperationalError("terminating connection")


@pytest.mark.parametrize("what", ["collector", "connection"])
def test_killed_at_any_moment_it_loses_and_doubles_nothing(
    what: str, server: Postgres, database: str, stored_site: StoredSite, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(stored_site, "mill", range(4))
    expected = [(channel, n + 1) for n in range(4) for channel in ("bed", "column")]
    with psycopg.connect(server.url(database), autocommit=True) as looking:
        for at in count(1):
            with monkeypatch.context() as patch:
                interrupted = DatabaseInterrupted(looking, at, what, patch)
                with suppress(CollectorKilled, CollectError), kept_in(server.url(database)) as kept:
                    catch_up(collector(stored_site, kept, limit=5))
            if not interrupted.happened:
                break
            with kept_in(server.url(database)) as kept:
                catch_up(collector(stored_site, kept, limit=5))
            steps = looking.execute("SELECT k FROM talc.steps ORDER BY k").fetchall()
            readings = looking.execute("SELECT channel, sequence FROM talc.readings ORDER BY row").fetchall()
            assert (steps, readings) == ([(FIRST_K + n,) for n in range(4)], expected), f"interrupted at call {at}"
            looking.execute("DROP SCHEMA talc CASCADE")
    assert at > 20


def test_while_the_database_is_down_nothing_is_lost_and_it_is_reported_once(
    server: Postgres, database: str, stored_site: StoredSite
) -> None:
    write(stored_site, "mill", range(5))
    with kept_in(server.url(database)) as kept:
        collecting = collector(stored_site, kept, limit=2)
        collecting.turn(0.0)
        server.stop()
        try:
            stored_site.asked.clear()
            with pytest.raises(CollectError, match=r"database: connection failed: .* Connection refused"):
                collecting.turn(0.0)
            assert stored_site.asked == [], "no gateway is asked for what cannot be kept"
        finally:
            server.start()
        write(stored_site, "mill", range(5, 9), "boot-2")
        catch_up(collecting, 30.0)
        assert problems(collecting) == {}
    assert steps_of(server, database) == list(range(9))


def test_after_the_server_started_again_the_same_turn_goes_on(
    server: Postgres, database: str, stored_site: StoredSite
) -> None:
    write(stored_site, "mill", range(5))
    with kept_in(server.url(database)) as kept:
        collecting = collector(stored_site, kept, limit=2)
        collecting.turn(0.0)
        server.stop()
        server.start()
        catch_up(collecting)
        assert problems(collecting) == {}
    assert steps_of(server, database) == list(range(5))


def test_rows_that_are_there_are_passed_over_when_the_progress_is_gone(
    server: Postgres, database: str, stored_site: StoredSite
) -> None:
    for boot, some in enumerate((range(9), range(9, 12))):
        write(stored_site, "mill", some, f"boot-{boot}")
        with kept_in(server.url(database)) as kept:
            collecting = collector(stored_site, kept)
            catch_up(collecting)
            assert problems(collecting) == {}
        server.query(database, "DELETE FROM talc.progress")
    assert steps_of(server, database) == list(range(12))
    assert len(in_database(server, database, "readings")) == 24


def test_a_backup_that_is_put_back_meanwhile_is_noticed(
    server: Postgres, database: str, stored_site: StoredSite
) -> None:
    write(stored_site, "mill", range(3))
    with kept_in(server.url(database)) as kept:
        collecting = collector(stored_site, kept)
        catch_up(collecting)
        server.query(database, "UPDATE talc.progress SET batch = 0, places = '{}'; DELETE FROM talc.steps")
        write(stored_site, "mill", range(3, 6), "boot-2")
        catch_up(collecting, 30.0)
        assert "another program has changed talc.progress" in problems(collecting)["mill"]
        catch_up(collecting, 60.0)
    assert steps_of(server, database) == list(range(6))


@pytest.mark.parametrize("places", ['{"steps": 5}', "[]", "null", '{"steps": [["e", "1"]]}', '{"steps": [["e", 1.5]]}'])
def test_invalid_progress_is_named_and_holds_up_only_its_machine(
    places: str, server: Postgres, database: str, stored_site: StoredSite, caplog: pytest.LogCaptureFixture
) -> None:
    write(stored_site, "mill", range(3))
    write(stored_site, "lathe", range(3))
    with kept_in(server.url(database)) as kept:
        catch_up(collector(stored_site, kept))
        server.query(database, f"UPDATE talc.progress SET places = '{places}' WHERE machine = 'mill'")
        again = collector(stored_site, kept)
        catch_up(again)
        assert list(problems(again)) == ["mill"]
        assert problems(again)["mill"].startswith("talc.progress, machine mill, places: ")
    assert not [record for record in caplog.records if record.exc_info]
    assert steps_of(server, database) == [0, 0, 1, 1, 2, 2]


def test_a_second_collector_is_kept_off_until_the_first_one_ends(server: Postgres, database: str) -> None:
    with kept_in(server.url(database)), pytest.raises(CollectError, match="another collector writes to it"):
        SiteDatabase(server.url(database), lock_wait_s=0.001).__enter__()
    with kept_in(server.url(database)):
        pass


def table(*columns: StoredColumn, numbers: tuple[int, ...] = (1, 2)) -> StoredRows:
    time = StoredColumn("time", "time", [1.7e9 + n for n in numbers])
    return StoredRows({"events": StoredTable(E, numbers[-1], numbers=list(numbers), columns=(time, *columns))})


class OnlySaw(StoredSite):
    """One machine, with these answers one after the other."""

    def __init__(self, folder: Path, *answers: StoredRows) -> None:
        super().__init__(folder)
        self.answers = iter(answers)

    def running(self) -> list[str]:
        return ["saw"]

    def ask(self, machine: str, after: object, limit: int) -> StoredRows:
        return next(self.answers)


def told(server: Postgres, database: str, tmp_path: Path, *answers: StoredRows) -> tuple[list[dict[str, Any]], str]:
    """What is kept from a machine's answers, and the last problem."""
    with kept_in(server.url(database)) as kept:
        collecting = collector(OnlySaw(tmp_path, *answers), kept)
        for turn, _ in enumerate(answers):
            collecting.turn(30.0 * turn)
    there = server.query(database, "SELECT 1 FROM pg_tables WHERE schemaname = 'talc' AND tablename = 'events'")
    return in_database(server, database, "events") if there else [], problems(collecting).get("saw", "")


def test_what_has_no_column_is_kept_in_the_column_for_others(server: Postgres, database: str, tmp_path: Path) -> None:
    long = "input_" + "x" * 64
    many = [StoredColumn(f"n{n}", "number", [n / 2, None]) for n in range(900)]
    changed = StoredColumn("n1", "text", [0], ("as text",))
    rows, problem = told(
        server,
        database,
        tmp_path,
        table(*many, StoredColumn(long, "number", [7.5, None])),
        table(changed, numbers=(3,)),
    )
    assert problem == ""
    first, second, third = rows
    kept = {**first, **first["other"]}
    assert {name: kept[name] for name in kept if name.startswith(("n", "input"))} == {
        **{f"n{n}": n / 2 for n in range(900)}, long: 7.5,
    }  # fmt: skip
    assert set(second) == {"machine", "time", "epoch", "row"}
    assert third["other"] == {"n1": "as text"}


def test_a_later_program_has_more_columns(server: Postgres, database: str, tmp_path: Path) -> None:
    rows, problem = told(
        server, database, tmp_path, table(), table(StoredColumn('a "new" 100%', "whole", [5]), numbers=(3,))
    )
    assert (problem, [row.get('a "new" 100%') for row in rows]) == ("", [None, None, 5])


def test_a_channel_s_course_has_an_index_also_in_a_table_of_an_older_program(
    server: Postgres, database: str, stored_site: StoredSite
) -> None:
    index = "readings_machine_channel_time_idx"

    def indexes() -> set[str]:
        found = server.query(database, "SELECT indexname FROM pg_indexes WHERE schemaname = 'talc'")
        return {row["indexname"] for row in found}

    for k in range(2):
        write(stored_site, "mill", range(3 * k, 3 * k + 3))
        with kept_in(server.url(database)) as kept:
            catch_up(collector(stored_site, kept))
        assert index in indexes()
        server.query(database, f"DROP INDEX talc.{index}")


def test_a_zero_byte_in_a_text_does_not_stop_a_machine(server: Postgres, database: str, tmp_path: Path) -> None:
    rows, problem = told(server, database, tmp_path, table(StoredColumn("text", "text", [0, None], ("a\0b",))))
    assert (problem, [row.get("text") for row in rows]) == ("", ["a\ufffdb", None])


@pytest.mark.parametrize(
    "columns",
    [
        (StoredColumn("n", "whole", [1, 2]), StoredColumn("n", "whole", [1, 2])),
        (StoredColumn("machine", "text", [0, 0], ("mill",)),),
        (StoredColumn("other", "text", [0, 0], ("mill",)),),
        (StoredColumn("n\0", "whole", [1, 2]),),
    ],
    ids=["twice", "the machine's", "that of others", "zero byte"],
)
def test_columns_that_no_gateway_has_are_reported_and_not_kept(
    columns: tuple[StoredColumn, ...], server: Postgres, database: str, tmp_path: Path
) -> None:
    rows, problem = told(server, database, tmp_path, table(*columns))
    assert (rows, bool(problem)) == ([], True)


def test_a_name_that_no_gateway_has_is_refused(server: Postgres, database: str) -> None:
    with kept_in(server.url(database)) as kept, pytest.raises(ValueError, match="no gateway has such a name"):
        kept.progress("a'b")


def test_a_database_of_another_encoding_is_refused(server: Postgres) -> None:
    server.query("postgres", "CREATE DATABASE latin ENCODING 'LATIN1' TEMPLATE template0")
    with pytest.raises(CollectError, match=r"LATIN1.*UTF8"):
        SiteDatabase(server.url("latin")).__enter__()


def test_a_role_needs_no_more_than_its_own_schema(server: Postgres, database: str, stored_site: StoredSite) -> None:
    for statement in ("CREATE ROLE writer LOGIN", "CREATE SCHEMA talc AUTHORIZATION writer"):
        server.query(database, statement)
    write(stored_site, "mill", range(3))
    with kept_in(server.url(database, "writer")) as kept:
        catch_up(collector(stored_site, kept))
    assert steps_of(server, database) == list(range(3))


def test_by_tls_and_with_a_password(server: Postgres, database: str, stored_site: StoredSite, tmp_path: Path) -> None:
    for statement in ("CREATE ROLE guarded LOGIN PASSWORD 'secret'", "CREATE SCHEMA talc AUTHORIZATION guarded"):
        server.query(database, statement)
    password, wrong = tmp_path / "password", tmp_path / "wrong"
    password.write_text("secret\n", encoding="utf-8")
    wrong.write_text("secrets\n", encoding="utf-8")
    plain = server.url(database, "guarded")
    trusted, other = (
        f"{plain}&sslmode=verify-full&sslrootcert={path}"
        for path in (server.authority, PlantAuthority(tmp_path / "other", "other").path)
    )
    write(stored_site, "mill", range(3))
    with SiteDatabase(trusted, password) as kept:
        catch_up(collector(stored_site, kept))
        query = "SELECT ssl FROM pg_stat_ssl JOIN pg_stat_activity USING (pid) WHERE usename = 'guarded'"
        assert server.query(database, query) == [{"ssl": True}]
    assert steps_of(server, database) == list(range(3))
    for url, file, said in (
        (trusted, wrong, "password authentication failed"),
        (trusted, None, "no password supplied"),
        (trusted, tmp_path / "none", "none: the password cannot be read: No such file or directory$"),
        (other, password, "certificate verify failed"),
        (f"{plain}&sslmode=disable", password, "pg_hba.conf rejects connection"),
    ):
        with pytest.raises(CollectError, match=said):
            SiteDatabase(url, file).__enter__()
