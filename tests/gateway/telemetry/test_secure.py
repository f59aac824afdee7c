"""Who may connect, read and query, and that no other samples are passed on: real Zenoh sessions on loopback."""

import asyncio
import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
import zenoh

from drivers.base import SystemClock
from gateway.config.telemetry import Operator, Telemetry, TelemetryTls
from gateway.model.commands import Command, CommandName, CommandOutcome
from gateway.model.text import plain
from gateway.telemetry.answers import HistoryPage
from gateway.telemetry.client import Machine, MachineError
from gateway.telemetry.command_signer import CommandSigner
from gateway.telemetry.history_queries import HistoryRequest
from gateway.telemetry.publisher import Obey
from gateway.telemetry.session import Access
from tests.benches.free_port import free_port
from tests.benches.open_publisher import OpenPublisher
from tests.benches.plant_authority import PlantAuthority
from tests.benches.plant_router import plant_router
from tests.benches.telemetry_peer import ROOT, problem
from tests.benches.waits import turns, wait_until

LIMIT_S = 60.0
ROWS = 40_000
PAGE = HistoryPage(
    0.0, ("a",), ("degC",), [1.7e9 + n for n in range(ROWS)], [0] * ROWS, [20.5] * ROWS, ["good"] * ROWS, None
)


def stored(_: HistoryRequest) -> HistoryPage:
    return PAGE


def publisher(settings: Telemetry, obey: Obey | None = None) -> OpenPublisher:
    return OpenPublisher(settings, "mill", (), SystemClock(), "boot-1", simulated=False, history=stored, obey=obey)


def _utc(seconds: float) -> datetime:
    return datetime.fromtimestamp(seconds, UTC)


class SecureSite:
    """A gateway by mutual TLS whose readers are named, and what its readers need."""

    def __init__(self, folder: Path) -> None:
        self.authority = PlantAuthority(folder / "plant")
        self.port = free_port()
        certificate, key = self.authority.issue("mill")
        self.tls = TelemetryTls(certificate=certificate, key=key, authority=self.authority.path, mutual=True)

    @property
    def here(self) -> str:
        return f"tls/127.0.0.1:{self.port}"

    def settings(self, *readers: str) -> Telemetry:
        return Telemetry(listen=(self.here,), tls=self.tls, readers=readers)

    def access(self, name: str, lasts: timedelta = timedelta(days=1), issuer: PlantAuthority | None = None) -> Access:
        certificate, key = (issuer or self.authority).issue(name, lasts)
        return Access(authority=self.authority.path, certificate=certificate, key=key)


def refused(where: str, access: Access) -> str:
    """What a reader that does not get in is told."""
    with pytest.raises(MachineError) as found:
        Machine(connect=where, access=access, answer_limit_s=LIMIT_S).__enter__()
    return str(found.value)


async def test_by_mutual_tls_a_reader_of_the_plant_gets_in_and_no_other(tmp_path: Path) -> None:
    site, other = SecureSite(tmp_path), PlantAuthority(tmp_path / "other")
    async with publisher(site.settings()) as gateway:
        gateway.publish(problem("by TLS"))
        with Machine(connect=site.here, access=site.access("alice")) as machine:
            assert next(machine.follow("event", quiet_s=LIMIT_S)).text == "by TLS"  # type: ignore[union-attr]
        for access in (
            Access(authority=site.authority.path),
            site.access("late", timedelta(days=-1)),
            site.access("stranger", issuer=other),
            Access(authority=other.path, certificate=site.tls.certificate, key=site.tls.key),
        ):
            assert f"no answer at {site.here}" in refused(site.here, access)
        assert "no answer" in refused(f"tcp/127.0.0.1:{site.port}", Access())


@pytest.mark.slow
@pytest.mark.waits(20)
async def test_a_reader_whose_certificate_ends_while_it_is_connected_is_shut_out(tmp_path: Path) -> None:
    """By the computer's clock, which Zenoh asks. Tolerance: 2 s before, as a certificate ends at a whole second; a
    minute after; and it must connect within the 20 s."""
    site, lasts = SecureSite(tmp_path), timedelta(seconds=20)
    async with publisher(site.settings()) as gateway:
        gateway.publish(problem("while it is valid"))
        ends_s = time.monotonic() + lasts.total_seconds()
        with reader(site.here, raw(site.access("brief", lasts))) as session:
            assert [b"while it is valid" in payload for payload in payloads(session)] == [True]
            while payloads(session):
                assert time.monotonic() < ends_s + LIMIT_S, "it still reads"
                await asyncio.sleep(0.5)
            assert time.monotonic() > ends_s - 2.0


async def test_by_tls_alone_a_reader_that_trusts_the_authority_gets_in(tmp_path: Path) -> None:
    site, other = SecureSite(tmp_path), PlantAuthority(tmp_path / "other")
    tls = TelemetryTls(certificate=site.tls.certificate, key=site.tls.key)
    async with publisher(Telemetry(listen=(site.here,), tls=tls)):
        with Machine(connect=site.here, access=Access(authority=site.authority.path)) as machine:
            assert machine.name == "mill"
        with Machine(connect=site.here, access=site.access("alice")) as machine:
            assert machine.name == "mill"
        for access in (Access(), Access(authority=other.path)):
            assert "no answer" in refused(site.here, access)


async def test_only_named_readers_of_those_that_connect_may_read(tmp_path: Path) -> None:
    site = SecureSite(tmp_path)
    async with publisher(site.settings("alice")) as gateway:
        gateway.publish(problem("for alice"))
        with Machine(connect=site.here, access=site.access("alice")) as machine:
            assert next(machine.follow("event", quiet_s=LIMIT_S)).text == "for alice"  # type: ignore[union-attr]
        assert "no gateway runs under talc" in refused(site.here, site.access("bob"))


@pytest.mark.parametrize("secret", ["wonderland", "wrong", None])
async def test_a_user_needs_the_password(tmp_path: Path, secret: str | None) -> None:
    users, port = tmp_path / "users", free_port()
    users.write_text("alice:wonderland\nbob:builder\n")
    where = f"tcp/127.0.0.1:{port}"
    access = Access() if secret is None else Access(user="alice", password=secret)
    async with publisher(Telemetry(listen=(where,), users_file=users, readers=("alice",))):
        if secret == "wonderland":
            with Machine(connect=where, access=access) as machine:
                assert machine.name == "mill"
            assert "no gateway runs" in refused(where, Access(user="bob", password="builder")), "not a reader"
        else:
            assert "no answer" in refused(where, access)


def reader(place: str, access: dict[str, Any]) -> zenoh.Session:
    config = zenoh.Config()
    for key, value in {"mode": "client", "scouting/multicast/enabled": False, **access}.items():
        config.insert_json5(key, json.dumps(value))
    config.insert_json5("connect/endpoints", json.dumps([place]))
    return zenoh.open(config)


class Intruder:
    """A session that forges a sample, answers queries and claims to be a gateway."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._queryable = session.declare_queryable(f"{ROOT}/**", self._answer)
        self._token = session.liveliness().declare_token("talc/ghost/alive")
        session.put(f"{ROOT}/event", b"forged")
        session.put("talc/**", b"forged")
        list(session.get(f"{ROOT}/**", timeout=LIMIT_S))  # all of it has arrived at the other side

    def _answer(self, query: zenoh.Query) -> None:
        with query:
            query.reply(f"{ROOT}/event", b"forged")


def payloads(session: zenoh.Session) -> list[bytes]:
    replies = session.get(f"{ROOT}/event", timeout=LIMIT_S, consolidation=zenoh.ConsolidationMode.NONE)
    return [reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None]


def alive(session: zenoh.Session) -> list[str]:
    replies = session.liveliness().get("talc/*/alive", timeout=LIMIT_S)
    return [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]


@contextmanager
def hearing(session: zenoh.Session) -> Iterator[list[bytes]]:
    heard: list[bytes] = []
    subscriber = session.declare_subscriber("talc/**", lambda sample: heard.append(sample.payload.to_bytes()))
    list(session.get(f"{ROOT}/**", timeout=LIMIT_S))  # the subscription has arrived
    yield heard
    subscriber.undeclare()


def assert_not_passed_on(gateway: OpenPublisher, good: zenoh.Session, bad: zenoh.Session) -> None:
    """Check that another reader hears, is answered by and finds only the gateway."""
    with hearing(good) as heard:
        Intruder(bad)
        for _ in turns(1000):
            gateway.publish(problem("the true one"))
            list(good.get(f"{ROOT}/**", timeout=LIMIT_S))
            if any(b"the true one" in payload for payload in heard):
                break
    assert b"forged" not in heard
    assert [b"the true one" in payload for payload in payloads(good)] == [True]
    assert alive(good) == [f"{ROOT}/alive"]


async def test_what_one_reader_sends_no_other_gets(tmp_path: Path) -> None:
    """Without any rule in the configuration: a Zenoh peer would pass it on."""
    where = f"tcp/127.0.0.1:{free_port()}"
    async with publisher(Telemetry(listen=(where,))) as gateway:
        with reader(where, {}) as good, reader(where, {}) as bad:
            assert_not_passed_on(gateway, good, bad)


async def test_a_password_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    settings = Telemetry(listen=(), user="mill", password_file=tmp_path / "password")
    async with publisher(settings) as gateway:
        assert gateway.reached.connection().problem.value_of("path") == str(settings.password_file)


def raw(access: Access) -> dict[str, Any]:
    tls = "transport/link/tls"
    return {
        f"{tls}/root_ca_certificate": str(access.authority),
        f"{tls}/connect_certificate": str(access.certificate),
        f"{tls}/connect_private_key": str(access.key),
        f"{tls}/enable_mtls": True,
    }


async def test_behind_the_plants_router_readers_read_a_large_page_and_can_send_nothing(tmp_path: Path) -> None:
    site, other = SecureSite(tmp_path), PlantAuthority(tmp_path / "other")
    with plant_router(site.authority) as where:
        async with publisher(Telemetry(mode="client", connect=(where,), tls=site.tls)) as gateway:
            gateway.publish(problem("by the router"))
            dashboard = site.access("dashboard")
            with Machine("mill", connect=where, access=dashboard) as machine:
                wait_until(lambda: machine.latest("event"))
                begin = site.authority.path.stat().st_mtime
                (page,) = machine.pages(_utc(begin), _utc(begin + 1.0))
                assert page == PAGE
            with (
                reader(where, raw(site.access("maintenance"))) as good,
                reader(where, raw(dashboard)) as bad,
            ):
                assert_not_passed_on(gateway, good, bad)
            assert "no gateway runs under talc" in refused(where, site.access("visitor"))
            for access in (
                Access(authority=site.authority.path),
                site.access("dashboard", timedelta(days=-1)),
                site.access("dashboard", issuer=other),
            ):
                assert "no answer" in refused(where, access)


async def test_another_machines_gateway_cannot_speak_for_the_mill(tmp_path: Path) -> None:
    site = SecureSite(tmp_path)
    with plant_router(site.authority) as where:
        async with publisher(Telemetry(mode="client", connect=(where,), tls=site.tls)) as gateway:
            with (
                reader(where, raw(site.access("maintenance"))) as good,
                reader(where, raw(site.access("lathe"))) as bad,
            ):
                assert_not_passed_on(gateway, good, bad)


async def test_behind_the_plants_router_only_a_panel_may_ask_for_commands(tmp_path: Path) -> None:
    site, key = SecureSite(tmp_path), tmp_path / "anna.key"
    key.write_text("anna" * 10, encoding="utf-8")
    anna = Operator(name="anna", key_file=key, may=(CommandName.PAUSE,))
    signer = CommandSigner.of_file("anna", key)

    async def obey(command: Command, refused: str) -> CommandOutcome:
        return CommandOutcome(command, _utc(0.0), not refused, plain(refused or "it is done"))

    def give(where: str) -> None:
        with Machine("mill", connect=where, access=site.access("panel"), operator=signer) as machine:
            assert machine.pause().text == "it is done"
        with Machine("mill", connect=where, access=site.access("dashboard"), operator=signer) as machine:
            wait_until(lambda: machine.latest("event"))  # everything else it may ask
            with pytest.raises(MachineError, match="no answer"):
                machine.pause()

    with plant_router(site.authority) as where:
        to_router = Telemetry(mode="client", connect=(where,), tls=site.tls, operator=(anna,))
        async with publisher(to_router, obey) as gateway:
            gateway.publish(problem("by the router"))
            await asyncio.to_thread(give, where)
