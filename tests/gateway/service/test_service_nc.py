"""The service and its NC link: the owner's number, what a restart resumes, and how the service releases the control."""

import asyncio
import math
import shutil
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import asynccontextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple
from unittest.mock import patch

import numpy as np
import pytest

from gateway.config.extended import validate
from gateway.config.model import GatewayConfig
from gateway.control.restart.earlier import EarlierRun
from gateway.model.events import MeasurementEnded, StoreHealth
from gateway.model.probing import End, Outcome
from gateway.model.text import plain
from gateway.nc.link import NcLink
from gateway.nc.settings import Identity
from gateway.service.service import Service
from gateway.storage.faults import StoreError
from gateway.storage.store import Store
from simulators.nc import Activity, DayPart, LoadCase, MeanLoads
from simulators.nc.nck import R_WITHDRAW
from simulators.nc.watchdog import R_OWNER
from talc.control import Controller
from talc.frame import Frame, Measurement, Why
from tests.benches.nc_link_bench import decision
from tests.benches.restarted import restarted
from tests.benches.wire_bench import WireBench, wire_bench

pytestmark = pytest.mark.simulated_time

CYCLE_S = 60.0
"""Each second costs several requests over the wire, and no test here is about a cycle's duration."""


def config(bench: WireBench, store: str, storage: Mapping[str, object]) -> GatewayConfig:
    return validate(
        {
            "machine": {"name": "mill"},
            "storage": {"path": str(bench.folder / store), **storage},
            "nc": {"kind": "sinumerik", "url": bench.url, "security": "none", "timeout_s": 30.0},
            "grid": {"step_s": 86400.0},  # no step, so no decision but the test's
            "probing": {"armed": True, "lead_s": 10.0},
            "compensation": {"mode": "compensate"},
        }
    )


class RunningGateway(NamedTuple):
    """A gateway that runs."""

    link: NcLink
    store: Store


@asynccontextmanager
async def serving(
    bench: WireBench,
    name: str = "a.sqlite",
    *,
    killed: bool = False,
    health: Callable[[], StoreHealth] = StoreHealth,
    storage: Mapping[str, object] = MappingProxyType({}),
    on_disk: Callable[[], Awaitable[None]] | None = None,
    learnt: tuple[GatewayConfig, Controller] | None = None,
) -> AsyncIterator[RunningGateway]:
    """A gateway with a database, which goes on from what an earlier one left there; stopped, or killed, at the end.

    on_disk: instead of the store's own
    learnt: a configuration, instead of `config`, and a controller to begin with
    """
    settings = config(bench, name, storage)
    past = EarlierRun(Controller(settings.input_names, settings.talc), proven=True)
    if learnt is not None:
        settings, past = learnt[0], EarlierRun(learnt[1], proven=True)
    if settings.storage.path.exists():
        past = replace(restarted(settings), proven=True)
    stop = asyncio.Event()
    boot = f"{name} {bench.clock.monotonic()}"
    with Store(settings.storage.path, boot, bench.clock, retry_s=0.2, origin="here") as store:
        store.begin(settings.canonical(), settings.fingerprint(), "")

        async def stored() -> None:
            with bench.clock.hold():
                await store.on_disk()

        with patch.object(NcLink, "stop", NcLink.disconnect) if killed else nullcontext():
            service = Service(
                settings,
                bench.clock,
                store.record,
                past,
                health=health,
                identity=Identity.of(boot, store.predecessor),
                on_disk=on_disk or stored,
            )
        assert service.link is not None
        running = asyncio.create_task(service.run(stop))
        try:
            yield RunningGateway(service.link, store)
        finally:
            stop.set()
            ending = asyncio.ensure_future(running)
            await bench.clock.run_until(bench.clock.monotonic() + 60.0)
            await ending


async def measured(bench: WireBench, gateway: RunningGateway) -> Outcome:
    """Measure as the grid loop does, which stores what comes."""
    outcome = await ended(bench, asyncio.create_task(gateway.link.measure(Why.INTERVAL)))
    gateway.store.record(MeasurementEnded(outcome))
    return outcome


async def ended(bench: WireBench, cycle: asyncio.Task[Outcome]) -> Outcome:
    for _ in range(100):
        await bench.clock.run_until(bench.clock.monotonic() + 10.0)
        if cycle.done():
            return cycle.result()
    raise AssertionError(f"{bench.control.nck.cycle.answer}")


@pytest.mark.slow
async def test_when_stopped_it_takes_the_offsets_back_and_releases_the_control(tmp_path: Path) -> None:
    async with wire_bench(tmp_path, CYCLE_S) as bench:
        async with serving(bench) as gateway:
            await bench.clock.run_until(2.0)
            gateway.link.follow(decision(6.0))
            await bench.clock.run_until(15.0)
            assert bench.in_force_um == pytest.approx((0.0, 0.0, 6.0))
        assert bench.in_force_um == (0.0, 0.0, 0.0)
        assert not any(entry.ramped for entry in bench.control.nck.log), "by itself, not by the control's watchdog"
        assert bench.control.nck.r[R_OWNER] == 0.0
        bench.assert_never_stepped()


@pytest.mark.slow
async def test_between_two_grid_steps_the_offsets_follow_the_spindle(tmp_path: Path) -> None:
    """The learner knows that EZ0A is 2 µm per 1000 1/min; the spindle starts 20 s after a step."""
    async with wire_bench(tmp_path) as bench:
        turning = DayPart(80.0, 1e9, Activity.TURNING, MeanLoads(spindle=4000.0))
        bench.control.nck.program = LoadCase([DayPart(0.0, 80.0, Activity.PAUSE, MeanLoads()), turning])
        settings = validate(
            config(bench, "a.sqlite", {}).model_dump(exclude_unset=True)
            | {"grid": {"step_s": 60.0}, "probing": {"lead_s": 10.0}, "state": [{"name": "spindle_speed"}]}
        )
        controller = Controller(settings.input_names, settings.talc)
        for k in range(100):
            speed = 5000.0 * (1.0 + math.sin(0.2 * k))
            measured = Measurement(2e-3 * speed * np.eye(9)[1], np.full(9, 0.5))
            controller.step(Frame(k, np.array([speed]), np.ones(1, dtype=np.bool_), measured))
        async with serving(bench, learnt=(settings, controller)):
            await bench.clock.run_until(79.0)
            assert abs(bench.in_force_um[2]) < 1.5
            await bench.clock.run_until(118.0)
            assert bench.in_force_um[2] == pytest.approx(8.0, abs=1.5)
        bench.assert_never_stepped()


@pytest.mark.slow
async def test_each_run_is_another_owner_and_takes_over_from_the_one_before_it_only(tmp_path: Path) -> None:
    async with wire_bench(tmp_path, CYCLE_S) as bench:
        owners = []

        async def owns(name: str) -> bool:
            async with serving(bench, name) as gateway:
                await bench.clock.run_until(bench.clock.monotonic() + 3.0)
                owners.append(bench.control.nck.r[R_OWNER])
                return gateway.link.present is not None

        assert await owns("a.sqlite")
        async with serving(bench, "a.sqlite"):
            await bench.clock.run_until(bench.clock.monotonic() + 3.0)
            shutil.copy(tmp_path / "a.sqlite", tmp_path / "copy.sqlite")
            assert not await owns("b.sqlite"), "refused"
        assert await owns("a.sqlite")
        async with serving(bench, "a.sqlite"):
            await bench.clock.run_until(bench.clock.monotonic() + 3.0)
            assert not await owns("copy.sqlite"), "a copy is another gateway"
        assert len(set(owners) - {0.0}) == 4


@pytest.mark.slow
async def test_a_restart_goes_on_with_the_reference_and_the_numbers(tmp_path: Path) -> None:
    async with wire_bench(tmp_path, CYCLE_S) as bench:
        nck = bench.control.nck
        async with serving(bench) as gateway:
            await bench.clock.run_until(2.0)
            reference = await measured(bench, gateway)
        nck.chip_um = dict.fromkeys(range(6), (0.0, 0.0, 5.0))
        async with serving(bench) as gateway:
            await bench.clock.run_until(bench.clock.monotonic() + 2.0)
            later = await measured(bench, gateway)
        assert reference.end is later.end is End.MEASURED, later.reason
        assert len(nck.cycle.ended) == 6
        assert later.number == reference.number + 1
        assert later.measurement is not None
        assert later.measurement.errors[1] == pytest.approx(5.0)


@pytest.mark.slow
async def test_killed_in_the_middle_of_a_cycle_its_request_is_withdrawn_and_its_number_is_used_up(
    tmp_path: Path,
) -> None:
    async with wire_bench(tmp_path, CYCLE_S) as bench:
        nck = bench.control.nck
        for _ in range(2):
            async with serving(bench, killed=True) as gateway:
                await bench.clock.run_until(bench.clock.monotonic() + 2.0)
                cycle = asyncio.create_task(gateway.link.measure(Why.INTERVAL))
                await bench.clock.run_until(bench.clock.monotonic() + 30.0)
                lost = nck.cycle.answer.number
                assert nck.cycle.started_s is not None
                cycle.cancel()
        async with serving(bench) as gateway:
            await bench.clock.run_until(bench.clock.monotonic() + 2.0)
            assert nck.r[R_WITHDRAW] == lost
            assert nck.cycle.started_s is None
            found = await measured(bench, gateway)
        assert found.end is End.MEASURED, found.reason
        assert found.number == lost + 5


@pytest.mark.slow
@pytest.mark.parametrize(("storage", "left"), [({}, 0.0), ({"compensate_unstored": True}, 6.0)])
async def test_while_nothing_can_be_stored_the_offsets_go_where_it_is_configured(
    storage: dict[str, object], left: float, tmp_path: Path
) -> None:
    health = StoreHealth()
    async with (
        wire_bench(tmp_path, CYCLE_S) as bench,
        serving(bench, health=lambda: health, storage=storage) as gateway,
    ):
        await bench.clock.run_until(2.0)
        gateway.link.follow(decision(6.0))
        await bench.clock.run_until(15.0)
        health = StoreHealth(plain("database or disk is full"), failing_s=59.0)
        await bench.clock.run_until(25.0)
        assert bench.in_force_um == pytest.approx((0.0, 0.0, 6.0)), "not at once"
        health = StoreHealth(plain("database or disk is full"), failing_s=61.0)
        await bench.clock.run_until(40.0)
        assert bench.in_force_um == pytest.approx((0.0, 0.0, left))
        health = StoreHealth()
        await bench.clock.run_until(60.0)
        assert bench.in_force_um == pytest.approx((0.0, 0.0, 6.0))
        bench.assert_never_stepped()


async def test_without_a_stored_number_no_cycle_is_requested(tmp_path: Path) -> None:
    async def locked() -> None:
        raise StoreError("database is locked")

    async with wire_bench(tmp_path, CYCLE_S) as bench, serving(bench, on_disk=locked) as gateway:
        await bench.clock.run_until(2.0)
        outcome = await measured(bench, gateway)
        assert outcome.end is End.REFUSED
        assert outcome.reason == "its number cannot be stored: database is locked"
        assert bench.control.nck.cycle.answer.number == 0


@pytest.mark.slow
async def test_while_a_number_is_not_stored_yet_the_offsets_are_kept_and_the_cycle_waits(tmp_path: Path) -> None:
    free = asyncio.Event()

    async def locked() -> None:
        await free.wait()

    async with wire_bench(tmp_path, CYCLE_S) as bench, serving(bench, on_disk=locked) as gateway:
        await bench.clock.run_until(2.0)
        gateway.link.follow(decision(6.0))
        await bench.clock.run_until(15.0)
        cycle = asyncio.create_task(gateway.link.measure(Why.INTERVAL))
        await bench.clock.run_until(60.0)
        assert bench.control.nck.cycle.answer.number == 0
        assert bench.in_force_um == pytest.approx((0.0, 0.0, 6.0)), "the heartbeat goes on"
        free.set()
        assert (await ended(bench, cycle)).end is End.MEASURED
        bench.assert_never_stepped()
