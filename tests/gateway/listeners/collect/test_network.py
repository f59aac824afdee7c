"""A site collected over Zenoh: the command, killed and started again, beside live messages; and the page's queries."""

import asyncio
import re
import signal
import subprocess
import sys
from asyncio.subprocess import Process
from collections.abc import Callable
from pathlib import Path

import pytest
import zenoh
from click.testing import CliRunner
from pyarrow import dataset

from drivers.base import SystemClock
from gateway.cli.main import main
from gateway.config.telemetry import Telemetry, TelemetryTls
from gateway.listeners.collect.collector import Collector
from gateway.listeners.collect.folder import SiteFolder
from gateway.listeners.collect.network import SiteNetwork
from gateway.service.stored_answers import rows_of
from gateway.storage.store import Store
from gateway.telemetry.answers import StoredRows
from gateway.telemetry.codec import encode
from tests.benches.free_port import free_port
from tests.benches.open_publisher import OpenPublisher
from tests.benches.plant_authority import PlantAuthority
from tests.benches.postgres import postgres
from tests.benches.stepped_clock import SteppedClock
from tests.benches.stored_site import step
from tests.benches.waits import until, wait_until
from tests.benches.zenoh_sessions import listening

PAGE = (Path(__file__).parents[4] / "docs" / "site.md").read_text(encoding="utf-8")
LIMIT_S = 120.0
CONNECTED = "SELECT pid FROM pg_stat_activity WHERE usename = 'guarded'"


def here(port: int) -> str:
    return f"tcp/127.0.0.1:{port}"


def gateway(port: int, database: Path, machine: str = "mill") -> OpenPublisher:
    settings = Telemetry(listen=(here(port),))
    return OpenPublisher(settings, machine, (), SystemClock(), "boot", simulated=False, stored=rows_of(database))


def write(store: Store, steps: range) -> None:
    for n in steps:
        step(store, n)
    store.flush()


def count(folder: Path, table: str) -> int:
    """Rows of a table, as a reader sees them while the collector writes."""
    files = sorted((folder / table).rglob("*.parquet"))
    return sum(dataset.dataset(file).count_rows() for file in files)


async def test_each_row_arrives_once_over_the_network_and_a_gateway_that_is_gone_is_left_out(tmp_path: Path) -> None:
    port, database = free_port(), tmp_path / "g.sqlite"
    telemetry = Telemetry(listen=(), connect=(here(port),))
    with (
        Store(database, "boot-1", SteppedClock()) as store,
        SiteFolder(tmp_path / "site") as folder,
        SiteNetwork(telemetry, LIMIT_S) as network,
    ):
        collecting = Collector(network, folder, every_s=1.0, limit=5)
        async with gateway(port, database):
            write(store, range(12))
            now_s = 0.0
            async with asyncio.timeout(LIMIT_S):
                while count(tmp_path / "site", "readings") < 24:
                    now_s += 1.0
                    await asyncio.to_thread(collecting.turn, now_s)
        assert await asyncio.to_thread(collecting.turn, now_s + 1.0) == now_s + 2.0
        assert collecting.machines["mill"].rows == {
            "measurements": 2,
            "steps": 12,
            "events": 2,
            "readings": 24,
            "reasons": 2,
        }
        assert collecting.machines["mill"].problem == ""


def do_two_answer(network: SiteNetwork) -> bool:
    """Whether both gateways answer: the collector may be connected to one before the other."""
    try:
        network.ask("mill", {"steps": None}, 1)
    except OSError as error:
        said = str(error)
    else:
        return False
    assert said.startswith("no answer within") or "2 gateways answer under this name" in said
    return "2 gateways" in said


def test_tables_that_a_gateway_was_too_slow_to_give_are_asked_for_again(tmp_path: Path) -> None:
    """Zenoh answers in its place, with an error that is no refusal."""
    port, held, asked = free_port(), list[zenoh.Query](), list[str]()

    def take(query: zenoh.Query) -> None:
        asked.append(str(query.parameters))
        if "steps" in str(query.parameters):
            held.append(query)
        else:
            query.reply(query.key_expr, encode(StoredRows({})))

    telemetry = Telemetry(listen=(), connect=(here(port),))
    with listening(port) as session, SiteNetwork(telemetry, 0.5) as site, SiteFolder(tmp_path / "site") as kept:
        declared = session.declare_queryable("talc/mill/stored", take)
        token = session.liveliness().declare_token("talc/mill/alive")
        wait_until(lambda: site.running() == ["mill"])
        collector = Collector(site, kept, every_s=0.5)
        for turn in range(2):
            collector.turn(float(turn))
            assert collector.machines["mill"].problem
        token.undeclare()
        declared.undeclare()
    assert [each for each in asked if "steps" not in each] == []


async def test_rows_of_two_gateways_of_one_name_are_not_mixed_and_come_when_one_has_another(tmp_path: Path) -> None:
    ports, stores = (free_port(), free_port()), (tmp_path / "a.sqlite", tmp_path / "b.sqlite")
    telemetry = Telemetry(listen=(), connect=tuple(map(here, ports)))
    for database, many in zip(stores, (4, 6), strict=True):
        with Store(database, "boot-1", SteppedClock()) as store:
            write(store, range(many))
    with SiteFolder(tmp_path / "site") as folder, SiteNetwork(telemetry, LIMIT_S) as network:
        collecting = Collector(network, folder)
        async with gateway(ports[0], stores[0]):
            async with gateway(ports[1], stores[1]):
                await asyncio.to_thread(wait_until, lambda: do_two_answer(network), LIMIT_S)
                await asyncio.to_thread(collecting.turn, 0.0)
                assert collecting.machines["mill"].problem.endswith("give each its own [machine] name")
            now_s = 0.0
            async with asyncio.timeout(LIMIT_S):
                while collecting.machines["mill"].problem:
                    now_s += 100.0
                    await asyncio.to_thread(collecting.turn, now_s)
    assert count(tmp_path / "site", "steps") == 4


async def test_by_mutual_tls_it_is_one_of_the_readers(tmp_path: Path) -> None:
    authority, port, database = PlantAuthority(tmp_path / "plant"), free_port(), tmp_path / "g.sqlite"
    where = f"tls/127.0.0.1:{port}"

    def tls(name: str) -> TelemetryTls:
        certificate, key = authority.issue(name)
        return TelemetryTls(certificate=certificate, key=key, authority=authority.path, mutual=True)

    settings = Telemetry(listen=(where,), tls=tls("mill"), readers=("collector",))
    publisher = OpenPublisher(settings, "mill", (), SystemClock(), "boot", simulated=False, stored=rows_of(database))
    with Store(database, "boot-1", SteppedClock()) as store, SiteFolder(tmp_path / "site") as folder:
        write(store, range(3))
        async with publisher:
            with SiteNetwork(Telemetry(listen=(), connect=(where,), tls=tls("collector")), LIMIT_S) as network:
                await until(network.running)  # the link is made meanwhile
                Collector(network, folder).turn(0.0)
    assert count(tmp_path / "site", "steps") == 3


async def until_kept(reached: Callable[[], bool], process: Process) -> None:
    await until(lambda: process.returncode is not None or reached(), LIMIT_S, pause_s=0.2)
    assert process.returncode is None


async def start(port: int, site: Path | str, *more: str) -> Process:
    words = ("collect", str(site), "--connect", here(port), "--every", "0.2", *more)
    return await asyncio.create_subprocess_exec(
        sys.executable, "-m", "gateway", *words, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )


@pytest.mark.slow
async def test_the_command_is_killed_and_goes_on_and_the_queries_of_the_page_give_what_they_say(
    tmp_path: Path,
) -> None:
    port, database, folder = free_port(), tmp_path / "g.sqlite", tmp_path / "site"
    with Store(database, "boot-1", SteppedClock()) as store:
        async with gateway(port, database):
            write(store, range(6))
            for more in (12, 18):
                process = await start(port, folder)
                await until_kept(lambda more=more: count(folder, "steps") >= more - 6, process)  # type: ignore[misc]
                write(store, range(more - 6, more))
                process.kill()
                await process.communicate()
            write(store, range(18, 24))  # what the last one says that it has collected
            process = await start(port, folder)
            await until_kept(lambda: count(folder, "readings") == 48, process)
            process.send_signal(signal.SIGTERM)
            out, err = await process.communicate()
    assert process.returncode == 0, err
    assert re.fullmatch(rf"{folder}: collecting .*\nmill: .*\d+ steps.*\n", out.decode())
    assert count(folder, "steps") == 24
    code = "\n".join(re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL))
    assert code.count("site/") == 2
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-c", code, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    out, err = await process.communicate()
    assert process.returncode == 0, err.decode()
    assert "mill" in out.decode()


@pytest.mark.peer
async def test_the_command_keeps_a_site_in_a_database_and_goes_on_after_it_was_killed(tmp_path: Path) -> None:
    port, database, password = free_port(), tmp_path / "g.sqlite", tmp_path / "password"
    password.write_text("secret\n", encoding="utf-8")
    with postgres() as server, Store(database, "boot-1", SteppedClock()) as store:
        for statement in ("CREATE ROLE guarded LOGIN PASSWORD 'secret'", "CREATE SCHEMA talc AUTHORIZATION guarded"):
            server.query("postgres", statement)
        address = f"{server.url(user='guarded')}&sslmode=verify-full&sslrootcert={server.authority}"
        more = ("--database-password-file", str(password))

        def stored() -> int:
            if server.query("postgres", "SELECT to_regclass('talc.steps') AS found") == [{"found": None}]:
                return 0
            return int(server.query("postgres", "SELECT count(*) AS many FROM talc.steps")[0]["many"])

        async with gateway(port, database):
            write(store, range(6))
            process = await start(port, address, *more)
            await until_kept(lambda: stored() == 6, process)
            process.kill()
            await process.communicate()
            await until(lambda: not server.query("postgres", CONNECTED))
            write(store, range(6, 12))
            process = await start(port, address, *more)
            await until_kept(lambda: stored() == 12, process)
            process.send_signal(signal.SIGTERM)
            out, err = await process.communicate()
    assert process.returncode == 0, err
    assert re.search(r"(?m)^mill: .*\b6 steps", out.decode())


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--connect", "nonsense"), "--connect: 'nonsense': expected PROTOCOL/HOST:PORT"),
        (("--connect", "tls/mill:7447"), "a tls/… endpoint needs --authority"),
        (("--connect", "tls/mill:7447", "--authority", "no.pem"), "no.pem': expected certificates in PEM"),
        (("--connect", "tls/mill:7447", "--certificate", "no.pem"), "certificate and key go together"),
        (("--connect", "tcp/mill:7447", "--user", "me"), "user and password_file go together"),
    ],
)
def test_a_wrong_option_is_named(words: tuple[str, ...], said: str, tmp_path: Path) -> None:
    (tmp_path / "no.pem").write_text("no")
    given = [str(tmp_path / word) if word == "no.pem" else word for word in words]
    answer = CliRunner().invoke(main, ["collect", str(tmp_path / "site"), *given])
    assert answer.exit_code == 2
    assert said in answer.output
    assert not (tmp_path / "site").exists()


def test_a_folder_that_is_a_file_is_named(tmp_path: Path) -> None:
    (tmp_path / "site").touch()
    answer = CliRunner().invoke(main, ["collect", str(tmp_path / "site"), "--connect", "tcp/127.0.0.1:1"])
    assert (answer.exit_code, f"{tmp_path / 'site'}: " in answer.output) == (3, True), answer.output
