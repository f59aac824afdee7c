"""The service manager gets signs of life only while every loop makes progress."""

import asyncio
import socket
from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

import pytest

from gateway.config.extended import validate
from gateway.config.file import parse
from gateway.config.model import GatewayConfig
from gateway.service.alive import WatchedClock, feed
from gateway.service.service_manager import ServiceManager
from tests.benches.kept_events import KeptEvents
from tests.benches.manual_clock import ManualClock
from tests.benches.reloaded_service import service_of
from tests.benches.service_file import FILE, TEXT
from tests.benches.stepped_clock import SteppedClock
from tests.benches.tasks import served
from tests.benches.telemetry_examples import configuration


class _HeldClock(ManualClock):
    def hold(self) -> AbstractContextManager[None]:
        return nullcontext()

    def synchronised(self) -> bool:
        return True

    def origin(self) -> str:
        return "test"


def works_s(config: GatewayConfig) -> Mapping[str, float]:
    """Of the parts of a service of this configuration."""
    return service_of(config, KeptEvents(), SteppedClock()).parts.works_s


LOOPS = ("grid", "stale", "storage", "health", "clock")


async def looping(clock: WatchedClock, hung: asyncio.Event) -> None:
    """Works at once, until it hangs."""
    while not hung.is_set():
        await clock.sleep_until(clock.monotonic() + 10.0)
    await asyncio.Event().wait()


def with_control() -> GatewayConfig:
    return validate(
        {
            "machine": {"name": "mill"},
            "nc": {"kind": "sinumerik", "url": "opc.tcp://nowhere:4840", "security": "none"},
        }
    )


def bus_loops(config: GatewayConfig) -> list[str]:
    return [f"bus {bus.name}" for bus in config.buses]


@pytest.mark.parametrize("hangs", ["grid", "nc"])
async def test_a_loop_that_hangs_is_named_and_no_other(hangs: str) -> None:
    time, config = _HeldClock(), with_control() if hangs == "nc" else configuration("first")
    clock, hung = WatchedClock(time), asyncio.Event()
    names = [*LOOPS, *bus_loops(config), *(["nc"] if config.nc else [])]
    clock.expect(works_s(config))
    tasks = [
        asyncio.create_task(looping(clock, hung if name == hangs else asyncio.Event()), name=name) for name in names
    ]
    try:
        for now in range(0, 300, 10):
            await time.pass_to(float(now))
            assert clock.stuck() == []
        hung.set()
        for now in range(300, 360, 10):
            await time.pass_to(float(now))
        assert clock.stuck() == [], "60 s of work may be"
        for now in (370, 380):
            await time.pass_to(float(now))
        assert clock.stuck() == [hangs]
        clock.expect(works_s(GatewayConfig.model_construct(**{**dict(config), "nc": None})))
        assert clock.stuck() == ([] if hangs == "nc" else [hangs]), "a reload removes the control"
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def test_a_loop_that_is_configured_and_does_not_run_is_stuck_until_a_reload_removes_it() -> None:
    time, config = _HeldClock(), configuration("first")
    clock = WatchedClock(time)
    clock.expect(works_s(config))
    time.now = 3600.0
    assert set(clock.stuck()) == {*LOOPS, *bus_loops(config)}
    clock.expect(works_s(GatewayConfig.model_construct(**{**dict(config), "buses": (), "devices": ()})))
    assert set(clock.stuck()) == set(LOOPS)
    clock.expect(works_s(with_control()))
    time.now = 7200.0
    assert set(clock.stuck()) == {*LOOPS, "nc"}


async def test_no_loop_of_a_service_that_runs_is_stuck() -> None:
    config, steps = parse(TEXT, FILE), SteppedClock()
    clock = WatchedClock(steps)
    clock.expect(works_s(config))
    async with served(service_of(config, KeptEvents(), clock)):
        for now in range(20, 400, 20):
            await steps.run_until(float(now))
            assert clock.stuck() == []


async def test_systemd_is_notified_while_every_loop_runs_and_while_the_service_stops(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    time, stop = _HeldClock(), asyncio.Event()
    clock = WatchedClock(time)
    clock.expect(works_s(configuration("first")))
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(tmp_path / "notify"))
        systemd.setblocking(False)
        manager = ServiceManager({"NOTIFY_SOCKET": str(tmp_path / "notify")})
        feeding = asyncio.create_task(feed(manager, 0.0, clock, stop))
        try:
            assert await signs(systemd) > 1
            time.now = 3600.0
            assert await signs(systemd) == 0, "no loop has waited for an hour"
            (told,) = [record.getMessage() for record in caplog.records]
            assert {"grid", "stale"} <= set(told.rpartition(": ")[2].split(", "))
            stop.set()
            assert await signs(systemd) > 1, "what ends may take its time"
        finally:
            feeding.cancel()


async def signs(systemd: socket.socket) -> int:
    """How many signs of life arrive in a few rounds."""
    for _ in range(3):
        await asyncio.sleep(0.0)
    found = 0
    while True:
        try:
            found += systemd.recv(100) == b"WATCHDOG=1"
        except BlockingIOError:
            return found
