"""Eight mistakes that keep a program from a router, each named by its cause: in the client, and in all that read."""

import socket
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from gateway.config.telemetry import Telemetry, TelemetryTls, endpoint
from gateway.model.codes import NoticeCode
from gateway.model.text import text_of
from gateway.telemetry.client import Machine, MachineError
from gateway.telemetry.reaching import cause
from gateway.telemetry.session import own_access
from gateway.telemetry.subscriber.sessions import PlaceSessions
from tests.benches.free_port import free_port
from tests.benches.plant_authority import DAY, PlantAuthority
from tests.benches.plant_router import plant_router
from tests.benches.waits import wait_until
from tests.benches.zenoh_sessions import router


class Site:
    """Routers of the plant: a right one, one whose certificate has expired, one whose certificate begins tomorrow, and
    one without TLS."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self.plant, self.other = PlantAuthority(folder / "plant"), PlantAuthority(folder / "other", "other")
        self.right = stack.enter_context(plant_router(self.plant))
        self.expired = stack.enter_context(plant_router(self.plant, lasts=-DAY))
        self.later = stack.enter_context(plant_router(self.plant, begins=DAY))
        self.plain = stack.enter_context(router(free_port()))
        self.own = self.plant.path, *self.plant.issue("dashboard")
        self.spare = self.plant.issue("spare")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    with ExitStack() as stack:
        yield Site(tmp_path_factory.mktemp("reaching"), stack)


def wrong(site: Site, mistake: str) -> tuple[str, Telemetry]:
    """Where a reader connects to, and how."""
    authority, certificate, key = site.own
    where = {
        "expired": site.expired,
        "clock": site.later,
        "plain for TLS": site.right.replace("tls/", "tcp/"),
        "TLS for plain": site.plain.replace("tcp/", "tls/"),
        "port": f"tls/127.0.0.1:{free_port()}",
    }.get(mistake, site.right)
    tls = TelemetryTls(
        authority=site.other.path if mistake == "authority" else authority,
        certificate=None if mistake == "no certificate" else certificate,
        key=None if mistake == "no certificate" else site.spare[1] if mistake == "key" else key,
    )
    return where, Telemetry(connect=(where,), tls=tls)


@pytest.mark.parametrize(
    ("mistake", "code"),
    [
        ("authority", NoticeCode.TLS_OTHER_AUTHORITY),
        ("expired", NoticeCode.TLS_EXPIRED),
        ("clock", NoticeCode.TLS_NOT_YET),
        ("no certificate", NoticeCode.TLS_CERTIFICATE_WANTED),
        ("key", NoticeCode.TLS_KEY_APART),
        ("plain for TLS", NoticeCode.PLACE_ENCRYPTED),
        ("TLS for plain", NoticeCode.PLACE_PLAIN),
        ("port", NoticeCode.PLACE_CLOSED),
    ],
)
def test_each_mistake_is_named(site: Site, mistake: str, code: NoticeCode) -> None:
    where, telemetry = wrong(site, mistake)
    with pytest.raises(MachineError) as raised, Machine("mill", connect=where, access=own_access(telemetry)):
        pass
    assert text_of(raised.value).says(code), raised.value
    with PlaceSessions(telemetry) as sessions:
        wait_until(lambda: any(problem.says(code) for problem in sessions.problems))


def test_a_certificate_for_another_host_is_named_with_the_hosts_that_it_is_for(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By a name that the resolver of this test gives to loopback, as the hosts file of a plant would."""
    real = socket.getaddrinfo

    def resolved(host: str, *more: Any) -> Any:
        return real("127.0.0.1" if host == "router" else host, *more)

    monkeypatch.setattr(socket, "getaddrinfo", resolved)
    found = cause(endpoint(site.right.replace("127.0.0.1", "router")), own_access(wrong(site, "")[1]))
    assert found is not None
    assert found.says(NoticeCode.TLS_OTHER_HOST)
    assert "localhost" in str(found.value_of("names"))
