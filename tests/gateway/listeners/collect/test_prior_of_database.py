"""A prior from a site in PostgreSQL is the one from its folder, byte by byte. The server is Debian's."""

from itertools import count
from pathlib import Path

import pytest

from gateway.listeners.collect.database_machines import machines_in_database
from gateway.listeners.collect.machines import CollectedMachine, machines_in
from tests.benches.collected_machines import collected, work
from tests.benches.machines_of_a_kind import talc_gateway
from tests.benches.postgres import Postgres

pytestmark = pytest.mark.peer
_names = count()


@pytest.fixture
def url(server: Postgres, gateways: Path) -> str:
    """The address of a database with everything that the gateways have."""
    url = server.created(f"priors{next(_names)}")
    collected(gateways, url)
    return url


def database(url: str) -> str:
    return url.partition("?")[0].rpartition("/")[2]


def steps(machine: CollectedMachine) -> list[tuple[object, ...]]:
    """What a learner gets, exactly."""
    return [
        (
            frame.k, frame.pause_unknown, frame.valid.tolist(), frame.inputs[frame.valid].tobytes(),
            None if frame.measurement is None
            else (frame.measurement.errors.tobytes(), frame.measurement.sigma.tobytes()),
        )
        for frame in machine.frames()
    ]  # fmt: skip


def test_the_prior_is_the_same_from_the_database_as_from_the_folder(url: str, site: Path, tmp_path: Path) -> None:
    of_database, of_folder = tmp_path / "database.json", tmp_path / "folder.json"
    answer = talc_gateway("prior", "make", url, "--kind", "dmu", "-o", of_database)
    assert answer.exit_code == 0, answer.output
    assert talc_gateway("prior", "make", site, "--kind", "dmu", "-o", of_folder).exit_code == 0
    assert of_database.read_bytes() == of_folder.read_bytes()


@pytest.mark.parametrize(
    "change",
    [
        'ALTER TABLE talc.steps DROP COLUMN "{column}"',
        'ALTER TABLE talc.steps ALTER "{column}" TYPE text USING NULL',
        'UPDATE talc.steps SET "{column}" = NULL WHERE k % 3 = 0',
    ],
    ids=["more columns than a table can have", "a text in the first row", "another type for some rows"],
)
def test_values_without_a_column_of_their_own_are_found(server: Postgres, url: str, site: Path, change: str) -> None:
    column = f"input_{machines_in(site)[0].inputs[0]}"
    moved = f"coalesce(other, '{{}}') || jsonb_build_object('{column}', \"{column}\")"
    server.query(database(url), f"UPDATE talc.steps SET other = {moved}")
    server.query(database(url), change.format(column=column))
    assert [steps(machine) for machine in machines_in_database(url)] == [steps(m) for m in machines_in(site)]


def test_the_first_copy_of_a_step_that_occurs_twice_counts(server: Postgres, url: str, site: Path) -> None:
    """For instance after a backup of a gateway's database was put back: the rows have a later epoch."""
    name, first = database(url), "SELECT epoch FROM talc.steps WHERE machine = 'mill10' ORDER BY time LIMIT 1"
    later = "'zz' || epoch"
    columns = server.query(
        name, "SELECT string_agg(quote_ident(column_name), ', ') AS names FROM information_schema.columns "
        "WHERE table_name = 'steps' AND column_name NOT IN ('epoch', 'pause_unknown')",
    )[0]["names"]  # fmt: skip
    for epoch in (later, "'00' || epoch"):
        server.query(
            name, f"INSERT INTO talc.steps ({columns}, epoch, pause_unknown) "
            f"SELECT {columns}, {epoch}, 1 - pause_unknown FROM talc.steps WHERE epoch = ({first})",
        )  # fmt: skip
        server.query(
            name, "UPDATE talc.progress SET places = jsonb_set(places, '{steps}', (places->'steps') || "
            f"(SELECT jsonb_agg(jsonb_build_array({epoch}, 1)) FROM ({first}) AS first))",
        )  # fmt: skip
    assert [steps(machine) for machine in machines_in_database(url)] == [steps(m) for m in machines_in(site)]


def test_a_collector_may_write_meanwhile(url: str, tmp_path: Path) -> None:
    frames = machines_in_database(url)[0].frames()
    next(frames)
    work(tmp_path, 13)
    collected(tmp_path, url)
    assert [machine.name for machine in machines_in_database(url)] == ["mill10", "mill11", "mill12", "mill13"]
    assert len(list(frames)) == len(list(machines_in_database(url)[0].frames())) - 1


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ("DROP SCHEMA talc CASCADE", "contains no run of any machine; give a database of `talc-gateway collect`"),
        ("UPDATE talc.runs SET talc = '{'", "talc.runs, machine mill10: its latest run cannot be read"),
        ("UPDATE talc.runs SET inputs = NULL", "talc.runs, machine mill10: its latest run cannot be read"),
        ("DELETE FROM talc.runs", "talc.runs, machine mill10: its latest run cannot be read: there is none"),
        ("DELETE FROM talc.progress", "contains no run of any machine; give a database of `talc-gateway collect`"),
        ("UPDATE talc.progress SET places = '[]'", "talc.progress, machine mill10, places"),
    ],
)
def test_a_database_that_cannot_be_used_is_refused(
    server: Postgres, url: str, changed: str, said: str, tmp_path: Path
) -> None:
    server.query(database(url), changed)
    answer = talc_gateway("prior", "make", url, "-o", tmp_path / "a.json")
    assert (answer.exit_code, (tmp_path / "a.json").exists()) == (3, False)
    assert said in answer.output


@pytest.mark.parametrize(
    ("address", "code", "said"),
    [
        ("postgresql://site:secret@127.0.0.1/site", 2, "a password in the address is seen by every user"),
        ("postgresql://127.0.0.1:1/site", 3, "database: connection failed"),
        ("mysql://127.0.0.1/site", 2, "no address of a database"),
    ],
)
def test_an_address_that_cannot_be_used_is_refused(address: str, code: int, said: str, tmp_path: Path) -> None:
    answer = talc_gateway("prior", "make", address, "-o", tmp_path / "a.json")
    assert answer.exit_code == code
    assert said in answer.output
    assert "secret" not in answer.output


def test_a_role_that_may_only_read_is_enough(server: Postgres, url: str, site: Path) -> None:
    for statement in (
        "CREATE ROLE reader LOGIN",
        "GRANT USAGE ON SCHEMA talc TO reader",
        "GRANT SELECT ON ALL TABLES IN SCHEMA talc TO reader",
    ):
        server.query(database(url), statement)
    read = machines_in_database(server.url(database(url), "reader"))
    assert [steps(machine) for machine in read] == [steps(machine) for machine in machines_in(site)]


def test_a_column_that_runs_do_not_have_is_empty(server: Postgres, url: str) -> None:
    """For instance of gateways that did not have it yet when they were collected."""
    server.query(database(url), "ALTER TABLE talc.runs DROP COLUMN kind")
    assert [machine.kind for machine in machines_in_database(url)] == [None, None, None]


def test_a_machine_without_a_run_yet_is_left_out(server: Postgres, url: str, site: Path) -> None:
    server.query(database(url), "INSERT INTO talc.progress VALUES ('new', 1, '{\"events\": [[\"e1\", 4]]}')")
    assert [machine.name for machine in machines_in_database(url)] == [machine.name for machine in machines_in(site)]


def test_an_address_that_is_given_twice_is_refused(url: str, tmp_path: Path) -> None:
    answer = talc_gateway("prior", "make", url, url, "-o", tmp_path / "a.json")
    assert answer.exit_code == 2
    assert "is given twice" in answer.output
