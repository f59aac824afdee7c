"""Each mode of a gateway, without a router, at one, and at one with rules, by each program that reads: 36 ways."""

import asyncio
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from drivers.base import SystemClock
from gateway.config.telemetry import Telemetry, TelemetryTls
from gateway.config.telemetry_rules import telemetry_problems
from gateway.listeners.collect.network import SiteNetwork
from gateway.listeners.outlets.outlet import OutletMessage
from gateway.listeners.outlets.source import GatewaySource
from gateway.telemetry.asking import QueryRefusal
from gateway.telemetry.client import Machine
from gateway.telemetry.session import own_access
from gateway.telemetry.subscriber.site import SiteSeen, SiteSubscription
from tests.benches.free_port import free_port
from tests.benches.open_publisher import OpenPublisher
from tests.benches.plant_authority import PlantAuthority
from tests.benches.plant_router import plant_router
from tests.benches.telemetry_peer import problem
from tests.benches.waits import wait_until
from tests.benches.zenoh_sessions import router

SAID = "heard in every way"


@dataclass(frozen=True)
class Way:
    """Where a gateway publishes, and where its readers connect to."""

    gateway: Telemetry
    reader: Telemetry


def watched(reader: Telemetry) -> None:
    with Machine("mill", connect=reader.connect, access=own_access(reader)) as machine:
        wait_until(lambda: any(getattr(message, "text", "") == SAID for message in machine.latest("event").values()))


def followed(reader: Telemetry) -> None:
    with Machine(connect=reader.connect, access=own_access(reader)) as machine:
        assert getattr(next(machine.follow("event", quiet_s=60.0)), "text", "") == SAID


def seen(reader: Telemetry) -> None:
    site = SiteSeen(reader.prefix, ("mill",))
    with SiteSubscription(site, reader):

        def is_shown() -> bool:
            with site.machines() as machines:
                return machines["mill"].alive and any(event.text == SAID for event in machines["mill"].events)

        wait_until(is_shown)


def forwarded(reader: Telemetry) -> None:
    heard: list[OutletMessage] = []
    with GatewaySource(reader, (), heard.append):
        wait_until(lambda: any(getattr(one.message, "text", "") == SAID for one in heard))


def collected(reader: Telemetry) -> None:
    with SiteNetwork(reader) as site:
        wait_until(lambda: site.running() == ["mill"])
        with pytest.raises(QueryRefusal, match="no store"):
            site.ask("mill", {"steps": None}, 10)


READERS: dict[str, Callable[[Telemetry], None]] = {
    "watch": watched, "client": followed, "web": seen, "opcua": seen, "publish": forwarded, "collect": collected,
}  # fmt: skip


@contextmanager
def without_router(_: Path) -> Iterator[dict[str, Any]]:
    yield {}


@contextmanager
def at_a_router(_: Path) -> Iterator[dict[str, Any]]:
    with router(free_port()) as where:
        yield {"connect": (where,)}


@contextmanager
def at_a_router_with_rules(folder: Path) -> Iterator[dict[str, Any]]:
    plant = PlantAuthority(folder)
    with plant_router(plant) as where:
        yield {"connect": (where,), "plant": plant}


def tls(plant: PlantAuthority | None, name: str) -> TelemetryTls:
    if plant is None:
        return TelemetryTls()
    certificate, key = plant.issue(name)
    return TelemetryTls(certificate=certificate, key=key, authority=plant.path)


@pytest.mark.parametrize("routed", [without_router, at_a_router, at_a_router_with_rules])
@pytest.mark.parametrize("mode", ["peer", "client"])
async def test_each_reader_hears_the_gateway_or_check_says_what_to_do(
    mode: str, routed: Callable[[Path], Any], tmp_path: Path
) -> None:
    here = f"tcp/127.0.0.1:{free_port()}"
    with routed(tmp_path / "plant") as site:
        connect, plant = site.get("connect", ()), site.get("plant")
        gateway = Telemetry(mode=mode, listen=(here,), connect=connect, tls=tls(plant, "mill"))
        if mode == "client" and not connect:
            assert [one.where for one in telemetry_problems(gateway)] == ["[telemetry] mode"]
            return
        assert list(telemetry_problems(gateway)) == []
        reader = Telemetry(connect=connect or (here,), tls=tls(plant, "dashboard"))
        async with OpenPublisher(gateway, "mill", (), SystemClock(), "boot", simulated=False) as published:
            published.publish(problem(SAID))
            failed = {name: why for name, read in READERS.items() if (why := await failure(read, reader))}
    assert failed == {}


async def failure(read: Callable[[Telemetry], None], reader: Telemetry) -> str:
    try:
        await asyncio.to_thread(read, reader)
    except (AssertionError, OSError) as error:
        return str(error) or type(error).__name__
    return ""
