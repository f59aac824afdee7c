"""`talc-gateway collect` into PostgreSQL: its addresses, and the command killed beside a gateway that goes on."""

import asyncio
import re
import signal
import sys
from asyncio.subprocess import PIPE, Process
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner

from drivers.base import SystemClock
from gateway.cli.main import main
from gateway.config.telemetry import Telemetry
from gateway.listeners.collect.database import database_parameters
from gateway.service.stored_answers import rows_of
from gateway.storage.store import Store
from tests.benches.free_port import free_port
from tests.benches.open_publisher import OpenPublisher
from tests.benches.postgres import Postgres, postgres
from tests.benches.stepped_clock import SteppedClock
from tests.benches.stored_site import step
from tests.benches.waits import LIMIT_S

PAGE = (Path(__file__).parents[4] / "docs" / "site.md").read_text(encoding="utf-8")


@pytest.fixture
def server() -> Iterator[Postgres]:
    with postgres() as running:
        yield running


@pytest.mark.parametrize(
    ("where", "sslmode"),
    [
        ("db.plant.example", "verify-full"),
        ("10.0.0.7", "verify-full"),
        ("127.0.0.1,db.plant.example", "verify-full"),
        ("db.plant.example/site?sslmode=require", "require"),
        ("localhost", None),
        ("[::1]:5433", None),
        ("/site?host=/run/postgresql", None),
        ("/site", None),
        ("localhost/site?hostaddr=10.0.0.7", "verify-full"),
    ],
)
def test_beyond_loopback_the_server_proves_who_it_is_unless_the_address_says_otherwise(
    where: str, sslmode: str | None
) -> None:
    assert database_parameters(f"postgresql://{where}").get("sslmode") == sslmode


@pytest.mark.parametrize(
    "address",
    [
        "postgresql://site:secret@127.0.0.1/site",
        "postgresql://127.0.0.1/site?password=secret",
        "mysql://127.0.0.1/site",
    ],
)
def test_an_invalid_address_is_refused_and_no_password_repeated(address: str) -> None:
    answer = CliRunner().invoke(main, ["collect", address, "--connect", "tcp/127.0.0.1:1"])
    assert answer.exit_code == 2, answer.output
    assert "secret" not in answer.output


@pytest.mark.peer
async def test_the_command_is_killed_and_goes_on_and_the_query_of_the_page_gives_what_it_says(
    server: Postgres, tmp_path: Path
) -> None:
    address = server.created("site")
    where, path = f"tcp/127.0.0.1:{free_port()}", tmp_path / "g.sqlite"
    settings = Telemetry(listen=(where,))
    words = ("-m", "gateway", "collect", address, "--connect", where, "--every", "0.2")

    async def collecting() -> Process:
        return await asyncio.create_subprocess_exec(sys.executable, *words, stdout=PIPE, stderr=PIPE)

    def steps_kept() -> object:
        return server.query("site", "SELECT count(*) AS kept FROM talc.steps")[0]["kept"]

    async def until_kept(steps: int, process: Process) -> None:
        there = "SELECT to_regclass('talc.steps') IS NOT NULL AS there"
        async with asyncio.timeout(LIMIT_S):
            while not (server.query("site", there)[0]["there"] and steps_kept() == steps):
                assert process.returncode is None
                await asyncio.sleep(0.2)

    with Store(path, "boot-1", SteppedClock()) as store:
        async with OpenPublisher(settings, "mill", (), SystemClock(), "boot", simulated=False, stored=rows_of(path)):
            for n in range(6):
                step(store, n)
            store.flush()
            process = await collecting()
            await until_kept(6, process)
            for n in range(6, 12):
                step(store, n)
            store.flush()
            process.kill()
            await process.communicate()
            process = await collecting()
            await until_kept(12, process)
            process.send_signal(signal.SIGTERM)
            out, err = await process.communicate()
    assert process.returncode == 0, err
    assert out.decode().splitlines()[0] == f"{address}: collecting what gateways at {where} have stored"
    (query,) = re.findall(r"```sql\n(.*?)```", PAGE, re.DOTALL)
    (row,) = server.query("site", query)
    assert (row["machine"], row["steps"]) == ("mill", 12)
