"""A gateway that cannot publish measures and stores, says why, and publishes all that has waited once it can."""

import asyncio
import shutil
import time
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path

import pytest

from drivers.base import SystemClock
from gateway.config.telemetry import Telemetry, TelemetryTls
from gateway.model.codes import NoticeCode
from gateway.model.events import DecisionMade, EventReported, HealthChecked
from gateway.model.text import Text
from gateway.service.serving import serve
from gateway.telemetry.client import Machine, MachineError
from gateway.telemetry.publisher import TelemetryPublisher
from gateway.telemetry.session import Access
from tests.benches.free_port import free_port
from tests.benches.kept_events import KeptEvents
from tests.benches.plant_authority import DAY, PlantAuthority
from tests.benches.service_file import two_temperatures
from tests.benches.stepped_clock import SteppedClock
from tests.benches.telemetry_peer import problem
from tests.benches.waits import LIMIT_S, turns, until
from tests.benches.zenoh_sessions import client, router

CURED_S = 10.0
"""Within which a gateway publishes after what was wrong is mended."""


@dataclass
class Site:
    """A router by mutual TLS, and a gateway that is to publish to it."""

    folder: Path
    port: int

    def __post_init__(self) -> None:
        self.plant, self.other = PlantAuthority(self.folder / "plant"), PlantAuthority(self.folder / "other")
        self.certificate, self.key = self.folder / "mill.pem", self.folder / "mill.key"
        self.authority = self.folder / "authority.pem"
        shutil.copy(self.plant.path, self.authority)
        self.certified()

    def certified(self, lasts: timedelta = 90 * DAY) -> None:
        """The gateway's certificate and key."""
        for made, own in zip(self.plant.issue("mill", lasts), (self.certificate, self.key), strict=True):
            shutil.copy(made, own)

    def settings(self) -> Telemetry:
        tls = TelemetryTls(certificate=self.certificate, key=self.key, authority=self.authority)
        return Telemetry(mode="client", connect=(f"tls/127.0.0.1:{self.port}",), tls=tls)

    def router(self, stack: ExitStack, begins: timedelta = -30 * DAY) -> None:
        certificate, key = self.plant.issue("router", begins=begins)
        tls = "transport__link__tls__"
        files = {"root_ca_certificate": self.plant.path, "listen_certificate": certificate, "listen_private_key": key}
        more = {f"{tls}{name}": str(path) for name, path in files.items()}
        stack.enter_context(router(self.port, "tls", **more, **{f"{tls}enable_mtls": True}))


async def heard_within(site: Site, gateway: TelemetryPublisher, texts: list[str], seconds: float) -> None:
    """Wait until a reader at the router gets the last of these, and check that the gateway says it is connected."""
    certificate, key = site.plant.issue("reader")
    access, end_s = Access(authority=site.plant.path, certificate=certificate, key=key), time.monotonic() + seconds

    def found() -> bool:
        try:
            with Machine("mill", connect=f"tls/127.0.0.1:{site.port}", access=access) as machine:
                return any(getattr(message, "text", "") == texts[-1] for message in machine.latest("event").values())
        except MachineError:  # its token reaches the router a moment after its connection
            return False

    await until(lambda: not gateway.reached.connection().problem, seconds)
    await until(found, max(1.0, end_s - time.monotonic()), 0.1)
    assert gateway.reached.connection().to == f"tls/127.0.0.1:{site.port}"


CAUSES = {
    "away": NoticeCode.PLACE_CLOSED,
    "authority": NoticeCode.TLS_OTHER_AUTHORITY,
    "certificate": NoticeCode.TLS_OWN_EXPIRED,
    "clock": NoticeCode.TLS_NOT_YET,
}


@pytest.mark.parametrize(("wrong", "cause"), CAUSES.items(), ids=CAUSES)
async def test_the_cause_is_named_and_the_cure_publishes(wrong: str, cause: NoticeCode, tmp_path: Path) -> None:
    """The clock: the router's certificate begins tomorrow, as one of today does for a computer of yesterday."""
    site = Site(tmp_path, free_port())
    with ExitStack() as stack:
        early = stack.enter_context(ExitStack())
        if wrong == "authority":
            shutil.copy(site.other.path, site.authority)
        if wrong == "certificate":
            site.certified(-DAY)
        if wrong != "away":
            site.router(early, DAY if wrong == "clock" else -30 * DAY)
        began_s = time.monotonic()
        publisher = TelemetryPublisher(site.settings(), "mill", (), SystemClock(), "boot", simulated=False)
        async with publisher as gateway:
            assert time.monotonic() - began_s < CURED_S, "it holds up the start"
            gateway.publish(problem("what was before"))
            await until(lambda: gateway.reached.connection().problem.says(cause))
            if wrong == "authority":
                shutil.copy(site.plant.path, site.authority)
            if wrong == "certificate":
                site.certified()
            if wrong == "clock":
                early.close()
            if wrong in ("away", "clock"):
                site.router(stack)
            await heard_within(site, gateway, ["what was before"], CURED_S)


async def test_what_has_waited_reaches_a_subscriber_whole_and_in_order() -> None:
    port, texts = free_port(), [f"number {n}" for n in range(300)]
    settings = Telemetry(mode="client", connect=(f"tcp/127.0.0.1:{port}",))
    async with TelemetryPublisher(settings, "mill", (), SystemClock(), "boot", simulated=False) as gateway:
        for text in texts:
            gateway.publish(problem(text))
        heard: list[bytes] = []
        with router(port), client(port) as reader:
            reader.declare_subscriber("talc/mill/event", lambda sample: heard.append(sample.payload.to_bytes()))
            await until(lambda: len(heard) == len(texts))
    assert [text for text, message in zip(texts, heard, strict=True) if text.encode() not in message] == []


async def test_a_gateway_decides_and_stores_without_its_router_and_says_what_it_waits_for(tmp_path: Path) -> None:
    port, step_s = free_port(), 300.0
    telemetry = {"mode": "client", "connect": [f"tcp/127.0.0.1:{port}"]}
    config = two_temperatures(tmp_path / "mill.db", {"telemetry": telemetry, "grid": {"step_s": step_s}})
    clock, kept, stop = SteppedClock(), KeptEvents(), asyncio.Event()
    running = asyncio.create_task(serve(config, clock, stop, simulated=True, more=(kept,)))
    try:
        await until(lambda: kept.of(HealthChecked))
        await clock.run_until(2 * step_s + 20.0)
        assert len(kept.of(DecisionMade)) == 2
        (away,) = [text for text in texts_of(kept) if text.says(NoticeCode.TELEMETRY_AWAY)]
        assert away.says(NoticeCode.PLACE_CLOSED)
        latest = kept.of(HealthChecked)[-1].health
        assert any(text.says(NoticeCode.WAITS_TELEMETRY) for text in latest.waits_for)
        with router(port):
            for turn in turns(int(LIMIT_S * 10)):
                await clock.run_until(2 * step_s + 20.0 + 10.0 * turn)
                if texts_of(kept)[-1].says(NoticeCode.TELEMETRY_BACK):
                    break
                await asyncio.sleep(0.1)
        health = kept.of(HealthChecked)[-1].health
        assert health.telemetry is not None
        assert health.telemetry.to == f"tcp/127.0.0.1:{port}"
    finally:
        stop.set()
        await running


def texts_of(kept: KeptEvents) -> list[Text]:
    return [reported.event.text for reported in kept.of(EventReported) if isinstance(reported.event.text, Text)]
