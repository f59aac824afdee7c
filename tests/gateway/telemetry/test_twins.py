"""Two gateways of one name at a router: each finds the other, and every reader keeps them apart and says so; a gateway
that the router's rules do not name is told so."""

import logging
from itertools import pairwise
from pathlib import Path

import pytest

from drivers.base import SystemClock
from gateway.config.telemetry import Telemetry, TelemetryTls
from gateway.listeners.outlets.outlet import OutletMessage
from gateway.listeners.outlets.source import GatewaySource
from gateway.listeners.umati.values import shown_now
from gateway.model.control_state import NcState
from gateway.model.events import Health, HealthChecked, StoreHealth
from gateway.telemetry import echo
from gateway.telemetry.subscriber.runs import HeardRuns
from gateway.telemetry.subscriber.site import SiteSeen, SiteSubscription
from tests.benches.free_port import free_port
from tests.benches.open_publisher import OpenPublisher
from tests.benches.plant_authority import PlantAuthority
from tests.benches.plant_router import plant_router
from tests.benches.telemetry_peer import problem
from tests.benches.waits import until
from tests.benches.zenoh_sessions import router


@pytest.fixture(autouse=True)
def asks_often(monkeypatch: pytest.MonkeyPatch) -> None:
    """A question in each look instead of every 10 s."""
    monkeypatch.setattr(echo, "_EVERY_S", 0.0)


def gateway(settings: Telemetry, boot: str, machine: str = "mill") -> OpenPublisher:
    return OpenPublisher(settings, machine, (), SystemClock(), boot, simulated=False)


def healthy() -> HealthChecked:
    return HealthChecked(Health(60.0, 30, 30, NcState.READY, None, (), StoreHealth()))


async def test_each_finds_the_other_and_readers_keep_them_apart(caplog: pytest.LogCaptureFixture) -> None:
    heard: list[OutletMessage] = []
    with router(free_port()) as where:
        settings = Telemetry(mode="client", connect=(where,))
        reader, site = Telemetry(connect=(where,)), SiteSeen("talc", ("mill",))
        async with gateway(settings, "a") as first, gateway(settings, "b") as second:
            with SiteSubscription(site, reader), GatewaySource(reader, (), heard.append):
                for one in (first, second):
                    one.publish(healthy())
                await until(
                    lambda: first.reached.connection().other == "b" and second.reached.connection().other == "a"
                )
                with caplog.at_level(logging.WARNING):
                    for n in range(20):
                        first.publish(problem(f"a {n}"))
                        second.publish(problem(f"b {n}"))
                    await until(lambda: two(site))
                    await until(lambda: caplog.text.count("another gateway has the same name") == 2)
                with site.machines() as machines:
                    seen = machines["mill"]
                    assert not seen.present, "the page shows it as not current"
                    assert {shown.status for shown in shown_now(seen, site.now_s()).values()} == {"BadNoCommunication"}
        runs = [one.message.boot for one in heard if one.message is not None]
        changes = sum(one != other for one, other in pairwise(runs))
        assert changes <= 1, "passed on in turn"


def two(site: SiteSeen) -> bool:
    with site.machines() as machines:
        return machines["mill"].two


def test_a_restart_is_no_second_gateway_and_the_one_that_is_left_is_followed_again() -> None:
    runs = HeardRuns(logging.getLogger(__name__))
    assert [runs.follows("mill", boot, at_s) for at_s, boot in ((0.0, "a"), (10.0, "a"), (15.0, "b"))] == [True] * 3
    assert not runs.two("mill", 15.0), "started again"
    assert not runs.follows("mill", "a", 20.0)
    assert runs.two("mill", 20.0)
    assert runs.follows("mill", "b", 25.0)
    assert runs.follows("mill", "a", 90.0), "b has ended"
    assert runs.follows("mill", "a", 160.0)
    assert not runs.two("mill", 160.0)


async def test_the_router_s_rules_admit_a_gateway_and_its_own_programs_and_one_that_they_do_not_name_says_so(
    tmp_path: Path,
) -> None:
    plant = PlantAuthority(tmp_path)

    def settings(name: str, where: str) -> Telemetry:
        certificate, key = plant.issue(name)
        tls = TelemetryTls(certificate=certificate, key=key, authority=plant.path)
        return Telemetry(mode="client", connect=(where,), tls=tls)

    with plant_router(plant) as where:
        async with (
            gateway(settings("mill", where), "a") as named,
            gateway(settings("lathe", where), "b", "lathe") as unnamed,
        ):
            for one in (named, unnamed):
                one.publish(healthy())
            await until(lambda: named.reached.connection().confirmed)
            await until(lambda: unnamed.reached.connection().confirmed is False)
            site = SiteSeen("talc", ("mill",))
            with SiteSubscription(site, settings("mill", where)):
                await until(lambda: is_alive(site))


def is_alive(site: SiteSeen) -> bool:
    with site.machines() as machines:
        return machines["mill"].alive and machines["mill"].status is not None
